#include "firmware_app/link/doctor.h"

#include <gtest/gtest.h>

#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace doctor_test {

std::map<std::string, double> good() {
  std::map<std::string, double> p{
      {"CAN_P1_DRIVER", 1},    {"CAN_D1_PROTOCOL", 1},  {"CAN_D1_UC_SER_EN", 1},  {"CAN_D1_UC_S1_NOD", 42},
      {"CAN_D1_UC_S1_IDX", 0}, {"CAN_D1_UC_S1_PRO", 2}, {"CAN_D1_UC_S1_BD", 921}, {"VISO_TYPE", 3},
      {"VISO_DELAY_MS", 20},   {"VISO_QUAL_MIN", 10},   {"VISO_POS_X", 0},        {"VISO_POS_Y", 0},
      {"VISO_POS_Z", 0},       {"AHRS_EKF_TYPE", 3},    {"EK3_ENABLE", 1},        {"VISO_SCALE", 1},
      {"VISO_ORIENT", 0},      {"VISO_POS_M_NSE", 0.2}, {"EK3_SRC_OPTIONS", 0}};
  for (const char* set : {"1", "2", "3"}) {
    for (const char* what : {"POSXY", "VELXY", "POSZ", "VELZ", "YAW"}) {
      p[std::string("EK3_SRC") + set + "_" + what] = std::string(set) == "2" ? 6 : std::string(set) == "1" ? 3 : 0;
    }
  }
  for (int channel = 1; channel <= 16; ++channel) p["RC" + std::to_string(channel) + "_OPTION"] = 0;
  return p;
}

DoctorConfig config() {
  DoctorConfig c;
  c.viso_delay_ms = 22;
  return c;
}

TEST(Doctor, FindsNothingWhereAllFits) {
  EXPECT_TRUE(diagnose(good(), config()).empty());
}

TEST(Doctor, WithoutTheTunnelTheBusDoesNotMatter) {
  auto parameters = good();
  parameters["CAN_D1_UC_SER_EN"] = 0;
  parameters.erase("CAN_P1_DRIVER");
  DoctorConfig c = config();
  EXPECT_EQ(diagnose(parameters, c).size(), 2U);
  c.through_tunnel = false;
  EXPECT_TRUE(diagnose(parameters, c).empty());
}

struct Wrong {
  const char* name;
  double value;
  double wanted;
  Severity severity;
};

class DoctorFinds : public ::testing::TestWithParam<Wrong> {};

TEST_P(DoctorFinds, TheOneThatDoesNotFitAndSaysWhatToSet) {
  auto parameters = good();
  parameters[GetParam().name] = GetParam().value;
  DoctorConfig c = config();
  c.t_body_cam = {0.1, 0, 0};
  const auto findings = diagnose(parameters, c);
  ASSERT_EQ(findings.size(), 1U) << (findings.empty() ? "" : findings[1].words);
  EXPECT_EQ(findings[0].parameter, GetParam().name);
  EXPECT_EQ(findings[0].severity, GetParam().severity);
  ASSERT_TRUE(findings[0].wanted.has_value());
  EXPECT_EQ(*findings[0].wanted, GetParam().wanted);
  EXPECT_NE(findings[0].words.find("Set " + std::string(GetParam().name) + " "), std::string::npos)
      << findings[0].words;
}

INSTANTIATE_TEST_SUITE_P(
    Each, DoctorFinds,
    ::testing::Values(
        Wrong{"VISO_SCALE", 2, 1, Severity::kError}, Wrong{"VISO_ORIENT", 4, 0, Severity::kError},
        Wrong{"VISO_POS_M_NSE", 5, 0.2, Severity::kWarning}, Wrong{"EK3_SRC_OPTIONS", 1, 0, Severity::kWarning},
        Wrong{"CAN_P1_DRIVER", 0, 1, Severity::kError}, Wrong{"CAN_D1_PROTOCOL", 0, 1, Severity::kError},
        Wrong{"CAN_D1_UC_SER_EN", 0, 1, Severity::kError}, Wrong{"CAN_D1_UC_S1_NOD", 43, 42, Severity::kError},
        Wrong{"CAN_D1_UC_S1_IDX", 1, 0, Severity::kError}, Wrong{"CAN_D1_UC_S1_PRO", 1, 2, Severity::kError},
        Wrong{"CAN_D1_UC_S1_BD", 115, 921, Severity::kWarning},
        Wrong{"CAN_D1_UC_S1_BD", 115200, 921, Severity::kWarning}, Wrong{"VISO_TYPE", 0, 3, Severity::kError},
        Wrong{"VISO_TYPE", 1, 3, Severity::kWarning}, Wrong{"VISO_DELAY_MS", 10, 22, Severity::kError},
        Wrong{"VISO_QUAL_MIN", -1, 10, Severity::kError}, Wrong{"VISO_QUAL_MIN", 0, 10, Severity::kWarning},
        Wrong{"VISO_QUAL_MIN", 90, 10, Severity::kWarning}, Wrong{"VISO_POS_X", 0.1, 0, Severity::kError},
        Wrong{"AHRS_EKF_TYPE", 2, 3, Severity::kError}, Wrong{"EK3_ENABLE", 0, 1, Severity::kError},
        Wrong{"EK3_SRC2_POSXY", 3, 6, Severity::kError}, Wrong{"EK3_SRC2_VELXY", 3, 6, Severity::kWarning},
        Wrong{"EK3_SRC2_POSZ", 3, 6, Severity::kWarning}, Wrong{"EK3_SRC2_VELZ", 3, 6, Severity::kWarning},
        Wrong{"EK3_SRC2_YAW", 0, 6, Severity::kError}));

TEST(Doctor, WhatIsNotToldIsNotCalledRight) {
  const auto findings = diagnose({}, config());
  EXPECT_GE(findings.size(), 12U);
  for (const Finding& f : findings) EXPECT_EQ(f.severity, Severity::kUnknown) << f.words;
  auto parameters = good();
  parameters["EK3_SRC2_POSZ"] = 1;
  parameters["EK3_SRC2_YAW"] = 1;
  EXPECT_TRUE(diagnose(parameters, config()).empty()) << "barometer and compass may stay";
}

// A switch of two positions selects sets 1 and 3; how many it has, no parameter tells.
TEST(Doctor, ASourceSwitchIsNamedWhereSetThreeIsNotLikeSetTwo) {
  auto parameters = good();
  parameters["RC7_OPTION"] = 90;
  const auto findings = diagnose(parameters, config());
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].severity, Severity::kNote);
  EXPECT_EQ(findings[0].parameter, "RC7_OPTION");
  EXPECT_NE(findings[0].words.find("Take one of three positions, or fill EK3_SRC3_* like EK3_SRC2_*"),
            std::string::npos);
  for (const char* what : {"POSXY", "VELXY", "POSZ", "VELZ", "YAW"}) parameters[std::string("EK3_SRC3_") + what] = 6;
  EXPECT_TRUE(diagnose(parameters, config()).empty());
}

TEST(Doctor, TheLatencyComparedWithIsCalledWhatItIs) {
  auto parameters = good();
  parameters["VISO_DELAY_MS"] = 90;
  const auto findings = diagnose(parameters, config());
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_NE(findings[0].words.find("the latency that you gave is 22 ms"), std::string::npos) << findings[0].words;
  DoctorConfig not_given = config();
  not_given.viso_delay_ms.reset();
  EXPECT_TRUE(diagnose(parameters, not_given).empty());
}

TEST(Doctor, ASubmarineHasNoLeastQuality) {
  auto parameters = good();
  parameters.erase("VISO_QUAL_MIN");
  DoctorConfig c = config();
  ASSERT_EQ(diagnose(parameters, c).size(), 1u);
  EXPECT_EQ(diagnose(parameters, c)[0].severity, Severity::kUnknown);
  c.submarine = true;
  ASSERT_EQ(diagnose(parameters, c).size(), 1u);
  EXPECT_EQ(diagnose(parameters, c)[0].severity, Severity::kNote);
}

TEST(Doctor, ReadsParametersOverTheTunnelAndAsksAgain) {
  LinkHarness h;
  h.heartbeat(false);
  h.run(0.1);
  ParameterReader reader({"VISO_TYPE", "VISO_DELAY_MS", "NO_SUCH"});
  int asked = 0;
  bool done = false;
  for (int i = 0; i < 5000 && !done; ++i) {
    done = reader.step(&h.link->endpoint(), h.now);
    h.step();
    // The autopilot answers each second question only.
    const std::size_t before = h.decoded;
    h.decoder->set_node_id(kTestAutopilot);
    for (; h.decoded < h.bus.sent.size(); ++h.decoded) {
      dronecan::Transfer transfer;
      dronecan::TunnelTargetted tunnel;
      if (!h.decoder->accept(h.bus.sent[h.decoded].second, h.now, &transfer) ||
          transfer.type_id != dronecan::TunnelTargetted::kType.id ||
          transfer.kind != dronecan::TransferKind::kMessage ||
          !dronecan::decode(transfer.payload, transfer.fd, &tunnel)) {
        continue;
      }
      h.parser.feed(tunnel.buffer.view(), [&](const mavlink::RawMessage& raw) {
        if (raw.id != mavlink::ParamRequestRead::kId) return;
        mavlink::ParamRequestRead question;
        mavlink::decode(raw, &question);
        EXPECT_EQ(question.target_system, 7);
        EXPECT_EQ(question.param_index, -1);
        if (++asked % 2 == 1 || question.param_id[0] == 'N') return;
        mavlink::ParamValue answer;
        answer.param_id = question.param_id;
        answer.param_value = question.param_id[5] == 'T' ? 3.0F : 25.0F;
        h.send_mavlink(answer);
      });
    }
    EXPECT_GE(h.decoded, before);
  }
  EXPECT_TRUE(done);
  EXPECT_EQ(asked, 2 + 2 + 5);
  EXPECT_EQ(reader.values(), (std::map<std::string, double>{{"VISO_TYPE", 3}, {"VISO_DELAY_MS", 25}}));
}

}  // namespace doctor_test
}  // namespace godwit::link
