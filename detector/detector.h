// The network behind one call: picture in, boxes out. The only file of the detector that OpenCV's DNN module stands
// behind.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "detector/box.h"
#include "detector/decode.h"
#include "detector/model_info.h"
#include "hal/rt/result.h"

namespace godwit::detector {

enum class Backend { kCpu, kCuda, kCudaFp16 };

struct DetectorOptions {
  Backend backend = Backend::kCpu;
  int threads = 1;     ///< of OpenCV, for the whole process: OpenCV has one setting only
  bool tiled = false;  ///< looks at squares of a wide picture, too (tiles.h): each takes as long as the whole
  DecodeOptions decode;
};

/// An 8-bit picture of one (grey) or three (blue, green, red) interleaved channels.
struct PictureView {
  const std::uint8_t* data = nullptr;
  int width = 0, height = 0;
  int stride = 0;  ///< bytes from row to row
  int channels = 1;
};

/// One network, one thread: detect() is called by the thread that owns the detector (OpenCV allocates inside it, so
/// never the camera, tracker or link thread).
class Detector {
 public:
  /// Loads a model with the metadata beside it and runs it once, so that the first real picture is not the slow one.
  /// Errors name the file and the reason: missing, truncated, an output of another shape or another number of classes.
  static rt::Result<Detector> open(const std::string& model_path, const DetectorOptions& options);
  /// The same with metadata given by the caller.
  static rt::Result<Detector> open(const std::string& model_path, const ModelInfo& info,
                                   const DetectorOptions& options);

  Detector(Detector&&) noexcept;
  Detector& operator=(Detector&&) noexcept;
  ~Detector();

  /// Finds objects; boxes in pixels of `picture`, surest first (Decoder::decode, and merge with tiles). Grey is
  /// replicated into three channels. An empty picture or a failure inside OpenCV is an error, and `boxes` is then
  /// empty; the next call may succeed.
  rt::Result<void> detect(const PictureView& picture, BoxList* boxes);

  const ModelInfo& info() const;
  bool movable(int class_id) const;
  Backend backend() const;  ///< the one in use
  /// What was asked for and could not be had ("no CUDA in this OpenCV, using the CPU"); empty if nothing.
  const std::string& warning() const;

 private:
  struct State;
  explicit Detector(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace godwit::detector
