#include <algorithm>
#include <gtest/gtest.h>
#include <string>

#include "hal/sim/flight/flight.h"
#include "tests/sim/test_scenario.h"

namespace godwit::sim {
namespace {

// One test each: a sanitizer makes worlds slowly.
class EachScenario : public testing::TestWithParam<std::string> {};

TEST_P(EachScenario, ReadsAndFliesClearOfEverything) {
  Scenario scenario = test::scenario(GetParam());
  scenario.world.ground_texels = 512;  // colours keep nobody from flying
  const Flight flight(scenario, 1);
  const rt::Result<void> clear = check_clearance(flight);
  EXPECT_TRUE(clear.ok()) << clear.error().message;
  EXPECT_GE(flight.duration_s(), 50);
  EXPECT_LE(flight.duration_s(), 90);
}

INSTANTIATE_TEST_SUITE_P(Scenarios, EachScenario, testing::ValuesIn(list_scenarios(GODWIT_SCENARIO_DIR)),
                         [](const auto& test) {
                           std::string name = test.param;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

}  // namespace
}  // namespace godwit::sim
