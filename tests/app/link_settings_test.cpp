#include "firmware_app/config/link_settings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_app/link/axis_words.h"

namespace godwit::app::link_settings_test {
namespace {

using link::Parameter;
using testing::ElementsAre;
using testing::HasSubstr;

std::vector<std::string> mistakes(const std::string& toml) {
  return parse_config(toml, "c.toml").mistakes;
}

TEST(LinkSettings, NoLinkUnlessOneIsNamed) {
  EXPECT_FALSE(wants_link(Config{}));
  EXPECT_TRUE(wants_link(parse_config("[can]\nbus = \"multicast:0\"\n", "c.toml").config));
  EXPECT_TRUE(wants_link(parse_config("[link]\nmavlink = \"udp:127.0.0.1:14540\"\n", "c.toml").config));
}

TEST(LinkSettings, MistakesNameKeyLineAndRemedy) {
  EXPECT_THAT(mistakes("[can]\nbus = \"can0\"\n"),
              ElementsAre(AllOf(HasSubstr("c.toml:2: can.bus:"), HasSubstr("multicast:N or socketcan:IFACE"))));
  EXPECT_THAT(mistakes("[link]\nmavlink = \"udp:here:14540\"\n"),
              ElementsAre(AllOf(HasSubstr("c.toml:2: link.mavlink:"), HasSubstr("here is no IPv4 address"))));
  EXPECT_THAT(mistakes("[can]\nbus = \"multicast:0\"\n[link]\nprofile = \"px4\"\n"),
              ElementsAre(AllOf(HasSubstr("c.toml:4: link.profile:"), HasSubstr("PX4 takes no MAVLink through CAN"))));
  EXPECT_THAT(mistakes("[can]\nnode_id = 10\n"), ElementsAre(HasSubstr("c.toml:2: can.node_id: 10 is")));
  EXPECT_THAT(
      mistakes("[link]\nT_body_cam = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, -1, 0,  0, 0, 0, 1]\n"),
      ElementsAre(HasSubstr("c.toml:2: link.T_body_cam: its first three rows and columns must be a right-handed")));
  EXPECT_THAT(mistakes("[link]\nT_body_cam = [1, 2, 3]\n"), ElementsAre(HasSubstr("one of 16 numbers")));
  EXPECT_THAT(mistakes("[link]\norigin = [97.4, 8.5, 488]\n"), ElementsAre(HasSubstr("c.toml:2: link.origin:")));
  EXPECT_THAT(mistakes("[link]\norigin = [47.4, 8.5]\n"), ElementsAre(HasSubstr("one of 3 numbers")));
}

TEST(LinkSettings, EveryKeyArrives) {
  const ConfigReport report = parse_config(
      "[can]\nbus = \"multicast:3\"\nnode_id = 55\nautopilot_node = 11\nserial_index = 2\nbaud_rate = 115200\n"
      "fd = true\ntelemetry_rate = 20\ntelemetry_base = 0x400\ntelemetry_fd = true\n"
      "[link]\nmavlink = \"serial:/dev/ttyTHS0:921600\"\nprofile = \"px4\"\nrate = 25\nsystem_id = 9\n"
      "arming = \"require_pose\"\nT_body_cam = [0, 0, 1, 0.1,  1, 0, 0, 0.2,  0, 1, 0, -0.3,  0, 0, 0, 1]\n"
      "world_heading_deg = 90\norigin = [47.4, 8.5, 488]\nbench_metric = true\nstate_folder = \"/var/lib/x\"\n",
      "c.toml");
  ASSERT_TRUE(report.ok()) << report.mistakes[0];
  const link::LinkSettings s = link_settings(report.config, std::nullopt);
  EXPECT_EQ(s.can, "multicast:3");
  EXPECT_EQ(s.mavlink, "serial:/dev/ttyTHS0:921600");
  EXPECT_EQ(s.state_folder, "/var/lib/x");
  const auto get = [&](Parameter p) { return s.link.parameters[static_cast<std::size_t>(p)]; };
  EXPECT_EQ(get(Parameter::kNodeId), 55);
  EXPECT_EQ(get(Parameter::kAutopilotNode), 11);
  EXPECT_EQ(get(Parameter::kSerialIndex), 2);
  EXPECT_EQ(get(Parameter::kBaudRate), 115200);
  EXPECT_EQ(get(Parameter::kCanFd), 1);
  EXPECT_EQ(get(Parameter::kTelemetryRate), 20);
  EXPECT_EQ(get(Parameter::kTelemetryBase), 0x400);
  EXPECT_EQ(get(Parameter::kTelemetryFd), 1);
  EXPECT_EQ(get(Parameter::kProfile), 1);
  EXPECT_EQ(get(Parameter::kRate), 25);
  EXPECT_EQ(get(Parameter::kSystemId), 9);
  EXPECT_EQ(get(Parameter::kRequirePose), 1);
  EXPECT_EQ(s.link.odometry.t_body_cam, Eigen::Vector3d(0.1, 0.2, -0.3));
  EXPECT_NEAR(s.link.odometry.world_heading_rad, M_PI / 2, 1e-12);
  EXPECT_TRUE(s.link.odometry.bench_metric);
  ASSERT_TRUE(s.link.mavlink.origin.has_value());
  EXPECT_EQ(s.link.mavlink.origin->latitude_deg, 47.4);
  EXPECT_EQ(s.link.mavlink.origin->longitude_deg, 8.5);
  EXPECT_EQ(s.link.mavlink.origin->altitude_m, 488);
}

TEST(LinkSettings, WhoMayWriteOverTheBusArrives) {
  const ConfigReport report = parse_config("[can]\nlock_parameters = true\nwriters = [10, 11]\n", "c.toml");
  ASSERT_TRUE(report.ok()) << report.mistakes[0];
  const link::LinkSettings s = link_settings(report.config, std::nullopt);
  EXPECT_TRUE(s.link.write_rules.locked);
  EXPECT_THAT(s.link.write_rules.only_nodes, ElementsAre(10, 11));
  EXPECT_THAT(mistakes("[can]\nwriters = [0]\n"), ElementsAre(HasSubstr("c.toml:2: can.writers:")));
}

TEST(LinkSettings, DefaultsAreThoseOfTheNode) {
  const link::LinkSettings s = link_settings(Config{}, std::nullopt);
  EXPECT_EQ(s.link.parameters, link::fallback_values());
  EXPECT_EQ(s.link.odometry.R_body_cam, link::OdometryConfig{}.R_body_cam);
  EXPECT_FALSE(s.link.mavlink.origin.has_value());
  EXPECT_FALSE(s.link.write_rules.locked);
  EXPECT_TRUE(s.link.write_rules.only_nodes.empty());
}

TEST(LinkSettings, TheConfigurationsMountingWinsOverTheCalibrations) {
  const std::array<double, 16> of_calibration{0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1};
  Config config;
  EXPECT_EQ(link_settings(config, of_calibration).link.odometry.t_body_cam, Eigen::Vector3d(1, 2, 3));
  config.link.T_body_cam = {0, 0, 1, 0.1, 1, 0, 0, 0.2, 0, 1, 0, -0.3, 0, 0, 0, 1};
  EXPECT_EQ(link_settings(config, of_calibration).link.odometry.t_body_cam, Eigen::Vector3d(0.1, 0.2, -0.3));
}

TEST(LinkSettings, TheMountingIsToldInWords) {
  EXPECT_EQ(link::mounting_words(link::OdometryConfig{}.R_body_cam),
            "the camera looks front, the top of its picture is up");
  const Eigen::Matrix3d down{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}};
  EXPECT_EQ(link::mounting_words(down), "the camera looks down, the top of its picture is front");
}

}  // namespace
}  // namespace godwit::app::link_settings_test
