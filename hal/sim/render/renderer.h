// Draws what the simulated camera sees: light that arrives at each pixel, depth, and which mover it shows.
//
// Triangles are rasterised in ray space (Davidovic et al., "3D Rasterization", 2012): a triangle's edges are planes
// through the eye, so a pixel is tested with its own ray, and any lens distortion is exact. Four samples a pixel smooth
// the silhouettes; surfaces are shaded once a pixel from mip-mapped materials. With a rolling shutter the planes move
// from row to row.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "hal/sim/render/optics.h"
#include "hal/sim/world/trajectory.h"
#include "hal/sim/world/world.h"

namespace godwit::sim {

/// Mounting and shutter. Camera frame: x right, y down, z forward. T_body_cam maps camera points into the body.
struct CameraRig {
  Lens lens;
  Mat3 R_body_cam = Mat3::Identity();
  Vec3 t_body_cam_m = Vec3::Zero();
  double readout_s = 0;  ///< rolling shutter: from the first to the last row; 0: global
};

struct CameraPose {
  Mat3 R_world_cam;
  Vec3 position_m;
  Vec3 velocity_cam_m_s, omega_cam_rad_s;  ///< camera frame
};

CameraPose camera_pose(const Trajectory& trajectory, const CameraRig& rig, double t_s);

/// A mover in the picture.
struct TrueBox {
  int mover = 0;
  MoverKind kind = MoverKind::kPerson;
  bool moving = false;
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;  ///< pixels, clipped to the picture; edges, so that x1 - x0 is the width
  int visible_px = 0;                     ///< pixels that show it; the rest is hidden
};

constexpr int kSamples = 4;     ///< a pixel
constexpr double kNear = 0.05;  ///< [m] nothing closer is drawn

/// Everything a frame needs is allocated by the constructor. One thread at a time. World and trajectory must outlive
/// it.
class Renderer {
 public:
  Renderer(const World& world, const Trajectory& trajectory, const CameraRig& rig);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Draws the picture whose middle row is exposed at t_s. No allocation.
  void render(double t_s);

  // The newest picture, rows of stride() values.
  int stride() const { return rays_.stride; }
  const float* radiance() const { return radiance_.data(); }            ///< 0..255 where fully lit
  const float* inverse_depth() const { return inverse_depth_.data(); }  ///< 1/z [1/m]; 0: nothing
  /// 0: no mover; else its index + 1.
  const std::uint16_t* mover_mask() const { return mover_mask_.data(); }
  const RayTable& rays() const { return rays_; }
  const CameraPose& pose() const { return pose_; }  ///< of the middle row
  /// Movers with at least one pixel in the newest picture.
  const std::vector<TrueBox>& boxes() const { return boxes_; }
  /// Triangles that did not fit into the buffers of the newest picture: 0 unless the world is too crowded.
  int dropped_triangles() const { return dropped_; }

 private:
  friend struct TileRaster;
  /// A surface as the newest frame sees it, in the camera frame of the middle row.
  struct FrameSurface {
    const Texture* texture;
    float u[3], v[3], u0, v0;
    float normal[3];
    float detail_ratio, albedo;  ///< albedo includes the light
    float velocity[3];           ///< of what it belongs to, camera frame [m/s]
    std::uint16_t mover;         ///< index + 1, 0: none
    bool ground;
  };
  /// Edges e.d >= 0 inside, and 1/z = q.d, for rays d = (x, y, 1).
  struct Coefficients {
    float e[3][3];
    float q[3];
  };
  struct Triangle {
    float vertex[3][3];
    std::uint32_t surface;
  };
  struct RowPose {
    Mat3 R;  ///< p_row = R p_mid + t
    Vec3 t;
    double dt_s;
  };

  static bool coefficients(const double v[3][3], Coefficients* out);
  void collect(double t_s);
  void add_terrain(double reach_m, int step, double lower_m, std::uint32_t surface);
  void add_objects();
  void add_movers(double t_s);
  void add_triangle(const Vec3& a, const Vec3& b, const Vec3& c, std::uint32_t surface);
  FrameSurface frame_surface(const Surface& s, const Mat3& R_world_thing, const Vec3& offset_m) const;
  bool in_sight(const Vec3& centre_cam, double radius) const;
  void draw_tile(int column, int row);
  void shade_tile(int column, int row, const float* depth, const std::uint32_t* surface);
  void cast_mover_shadows(double t_s);
  void find_boxes();
  RowPose row_pose(double row, double t_s) const;
  Vec2 project_rolling(const Vec3& p_mid, const Vec3& velocity_cam) const;

  const World& world_;
  const Trajectory& trajectory_;
  CameraRig rig_;
  RayTable rays_;
  CameraPose pose_;
  std::vector<RowPose> row_poses_;  ///< at the upper edge of each row of tiles, and one more; rolling shutter only
  float margin_ = 0;                ///< rays by which the picture's motion during readout may shift a thing

  std::vector<FrameSurface> surfaces_;
  std::vector<Triangle> triangles_;
  std::vector<Coefficients> coefficients_;
  struct Node {
    std::uint32_t triangle, next;
  };
  std::vector<Node> nodes_;
  static constexpr std::uint32_t kNoNode = 0xffffffffu;
  std::vector<std::uint32_t> heads_;  ///< first node of each tile, or kNoNode
  std::vector<Vec3> corner_cache_;    ///< terrain corners in the camera frame
  std::vector<float> radiance_, inverse_depth_;
  std::vector<std::uint8_t> ground_;
  std::vector<std::uint16_t> mover_mask_;
  std::vector<int> mover_pixels_;
  struct MoverInSight {
    int mover;
    std::uint32_t first_triangle, end_triangle;
    Vec3 velocity_cam;
    MoverState state;
    Vec3 shift;  ///< to the copy of the world that is seen
  };
  std::vector<MoverInSight> movers_;
  std::vector<TrueBox> boxes_;
  int dropped_ = 0;
  float haze_radiance_ = 0;
};

}  // namespace godwit::sim
