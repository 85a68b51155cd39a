// The link's small parts: storage, queues, ports, bits on the wire, MAVLink parsing.
#include <cmath>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <pty.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <termios.h>
#include <unistd.h>

#include "firmware_app/link/byte_port.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/frame_bits.h"
#include "firmware_app/link/saved_parameters.h"
#include "firmware_app/link/storage.h"
#include "tests/link/fake_bus.h"
#include "tests/link/hex.h"

namespace godwit::link {
namespace parts_test {

class StorageTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "godwit-link-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder); }
  bool save(Storage& storage, const StorageRequest& request) {
    EXPECT_TRUE(storage.request(request));
    storage.serve();
    StorageReply reply;
    EXPECT_TRUE(storage.reply(&reply));
    EXPECT_EQ(reply.ticket, request.ticket);
    return reply.ok;
  }
  std::string folder;
};

TEST_F(StorageTest, KeepsAndErases) {
  Storage storage(folder);
  auto fresh = storage.load(fallback_values());
  ASSERT_TRUE(fresh.ok());
  EXPECT_FALSE(fresh.value().has_parameters);
  EXPECT_EQ(fresh.value().reset_counter, 0);
  StorageRequest request;
  request.ticket = 5;
  request.parameters = fallback_values();
  request.parameters[0] = 33;
  EXPECT_TRUE(save(storage, request));
  request.kind = StorageRequest::Kind::kReserveResets;
  request.reset_counter = 255;
  EXPECT_TRUE(save(storage, request));
  auto kept = storage.load(fallback_values());
  ASSERT_TRUE(kept.ok());
  EXPECT_TRUE(kept.value().has_parameters);
  EXPECT_EQ(kept.value().parameters[0], 33);
  EXPECT_EQ(kept.value().reset_counter, 0) << "it goes round";
  request.kind = StorageRequest::Kind::kEraseParameters;
  EXPECT_TRUE(save(storage, request));
  EXPECT_TRUE(save(storage, request)) << "nothing left to erase is no failure";
  EXPECT_FALSE(storage.load(fallback_values()).value().has_parameters);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 2) << "no half-written files stay";
}

TEST_F(StorageTest, DamagedFilesNameThemselvesAndGroundNobody) {
  const auto message = [&](const char* file, const char* text) {
    std::ofstream(folder + "/" + file) << text;
    const auto loaded = Storage(folder).load(fallback_values());
    std::filesystem::remove(folder + "/" + file);
    EXPECT_TRUE(loaded.ok()) << text;
    if (!loaded.ok() || loaded.value().warnings.empty()) return std::string();
    EXPECT_EQ(loaded.value().parameters[0], fallback_values()[0]) << "the configuration's";
    return loaded.value().warnings[0];
  };
  EXPECT_NE(message("link_parameters.txt", "# x\nVIO_RATE abc\n").find("link_parameters.txt:2:"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE 999\n").find("20 to 40"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE 30 30\n").find(":1:"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE\n").find(":1:"), std::string::npos);
  EXPECT_EQ(message("link_parameters.txt", "VIO_FROM_THE_FUTURE 7\n"), "");
  EXPECT_NE(message("link_reset_counter.txt", "300\n").find("link_reset_counter.txt"), std::string::npos);
  EXPECT_NE(message("link_reset_counter.txt", "").find("link_reset_counter.txt"), std::string::npos);
}

TEST_F(StorageTest, OnlyWhatWasChangedIsSavedAndTheRestFollowsTheFile) {
  Storage storage(folder);
  ASSERT_TRUE(storage.load(fallback_values()).ok());
  StorageRequest request;
  request.parameters = request.defaults = fallback_values();
  request.parameters[0] = 33;
  EXPECT_TRUE(save(storage, request));
  ParameterValues other = fallback_values();
  const auto require_pose = static_cast<std::size_t>(Parameter::kRequirePose);
  other[require_pose] = 1;  // the file asks for a pose from now on
  const StoredState state = storage.load(other).value();
  EXPECT_EQ(state.parameters[require_pose], 1);
  EXPECT_EQ(state.parameters[0], 33);
  const auto told = overrides(other, state);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0], "VIO_RATE 33, saved over the bus, overrides 30 of the configuration");
}

TEST_F(StorageTest, WhatWasSavedAndDoesNotFitIsDroppedAndTheFileFlies) {
  Storage storage(folder);
  ASSERT_TRUE(storage.load(fallback_values()).ok());
  const auto fits = [&](Parameter p, std::int64_t value, const LinkMeans& means) {
    StoredState state;
    state.parameters = fallback_values();
    state.has_parameters = true;
    state.parameters[static_cast<std::size_t>(p)] = value;
    drop_what_does_not_fit(fallback_values(), means, &state);
    EXPECT_NE(state.parameters == fallback_values(), state.warnings.empty());
    return state.warnings.empty();
  };
  EXPECT_FALSE(fits(Parameter::kProfile, 1, {true, false, true})) << "PX4 through the tunnel";
  EXPECT_TRUE(fits(Parameter::kProfile, 1, {true, true, true}));
  EXPECT_FALSE(fits(Parameter::kCanFd, 1, {true, false, false}));
  EXPECT_FALSE(fits(Parameter::kTelemetryFd, 1, {true, false, false}));
  EXPECT_TRUE(fits(Parameter::kCanFd, 1, {true, false, true}));
  EXPECT_FALSE(fits(Parameter::kNodeId, 10, {true, false, true})) << "the autopilot's";
  EXPECT_FALSE(fits(Parameter::kAutopilotNode, 42, {true, false, true})) << "ours";
}

TEST_F(StorageTest, TwoInOneFolderAreOneTooMany) {
  {
    Storage first(folder), second(folder);
    ASSERT_TRUE(first.load(fallback_values()).ok());
    const auto refused = second.load(fallback_values());
    ASSERT_FALSE(refused.ok());
    EXPECT_NE(refused.error().message.find("another godwit"), std::string::npos);
    EXPECT_TRUE(first.load(fallback_values()).ok()) << "it holds it already";
  }
  EXPECT_TRUE(Storage(folder).load(fallback_values()).ok()) << "free again";
}

TEST_F(StorageTest, AFolderThatCannotBeWrittenToGroundsNobody) {
  Storage storage("/proc/self");  // not even by root
  const auto state = storage.load(fallback_values());
  ASSERT_TRUE(state.ok()) << state.error().message;
  ASSERT_EQ(state.value().warnings.size(), 1u);
  EXPECT_NE(state.value().warnings[0].find("nothing can be kept"), std::string::npos);
}

TEST_F(StorageTest, PipesAndPlantedLinksNeitherHoldNorLead) {
  ASSERT_EQ(mkfifo((folder + "/link_parameters.txt").c_str(), 0600), 0);
  Storage storage(folder);
  const auto state = storage.load(fallback_values());  // would wait here for a writer
  ASSERT_TRUE(state.ok());
  EXPECT_EQ(state.value().warnings.size(), 1u);
  const std::string victim = folder + "/victim";
  std::ofstream(victim) << "precious";
  std::filesystem::create_symlink(victim, folder + "/link_reset_counter.txt.part");
  StorageRequest request;
  request.kind = StorageRequest::Kind::kReserveResets;
  EXPECT_TRUE(save(storage, request));
  std::string kept;
  std::ifstream(victim) >> kept;
  EXPECT_EQ(kept, "precious");
}

/// A serial device that comes and goes, under one name.
class SerialLine {
 public:
  explicit SerialLine(const std::string& folder) : name(folder + "/tty") { plug(); }
  ~SerialLine() { unplug(); }
  void plug() {
    EXPECT_EQ(openpty(&ours_, &theirs_, nullptr, nullptr, nullptr), 0);
    std::filesystem::create_symlink(ttyname(theirs_), name);
  }
  void unplug() {
    std::filesystem::remove(name);
    for (int* fd : {&ours_, &theirs_}) {
      if (*fd >= 0) close(*fd);
      *fd = -1;
    }
  }
  const std::string name;

 private:
  int ours_ = -1, theirs_ = -1;
};

TEST_F(StorageTest, ASerialLineThatGoesIsLeftAloneAndOpenedAgain) {
  SerialLine line(folder);
  auto opened = open_byte_port("serial:" + line.name + ":115200");
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  BytePort& port = *opened.value();
  EXPECT_EQ(port.baud_rate(), 115200);
  const std::array<std::uint8_t, 20> message{};
  std::array<std::uint8_t, 100> into{};
  EXPECT_TRUE(port.send(message, TxClass::kFlight));
  line.unplug();
  EXPECT_EQ(port.receive(into), 0u);
  EXPECT_TRUE(port.gone());
  EXPECT_EQ(port.descriptor(), -1) << "poll would return at once for ever";
  EXPECT_FALSE(port.send(message, TxClass::kPose));
  rt::TimeNs now = 100 * rt::kNsPerSecond;
  port.maintain(now);
  EXPECT_TRUE(port.gone());
  line.plug();
  port.maintain(now + rt::kNsPerMs);
  EXPECT_TRUE(port.gone()) << "tried once a second";
  port.maintain(now + rt::kNsPerSecond);
  EXPECT_FALSE(port.gone());
  EXPECT_TRUE(port.send(message, TxClass::kFlight));
  EXPECT_EQ(port.receive(into), 0u);
  EXPECT_FALSE(port.gone());
}

TEST_F(StorageTest, WhatCannotBeSavedSaysSo) {
  Storage nowhere(""), missing(folder + "/gone");
  StorageRequest request;
  EXPECT_FALSE(save(nowhere, request));
  EXPECT_NE(nowhere.last_error().find("state folder"), std::string::npos);
  EXPECT_FALSE(save(missing, request));
  EXPECT_NE(missing.last_error().find("gone"), std::string::npos);
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(nowhere.request(request));
  EXPECT_FALSE(nowhere.request(request)) << "a full ring refuses";
}

TEST(TxQueue, TransferIdsLeaveNoGapsWhenMessagesAreDropped) {
  TxQueue queue;
  FakeBus bus;
  bus.budget = 0;
  std::uint8_t id = 31;
  const std::array<std::uint8_t, 20> payload{};
  const auto add = [&](TxClass tx_class) {
    ASSERT_TRUE(queue.begin(tx_class, 0));
    queue.add({.type_id = 3001, .source = 42, .payload = payload}, 0, &id);
    queue.add({.type_id = 3001, .source = 42, .payload = payload}, 0, &id);
    EXPECT_NE(queue.commit(), 0U);
  };
  for (int i = 0; i < 5; ++i) {
    add(TxClass::kPose);
    queue.drain(bus, 0, 100);
  }
  EXPECT_EQ(queue.counters().poses_replaced, 4U);
  bus.budget = 2;  // begins the newest
  queue.drain(bus, 0, 100);
  bus.budget = 0;
  add(TxClass::kPose);
  EXPECT_EQ(queue.counters().poses_replaced, 4U) << "a message that began is finished";
  bus.budget = SIZE_MAX;
  queue.drain(bus, 0, 100);
  std::vector<int> ids;
  for (const auto& [t, f] : bus.sent) {
    if ((f.data[f.length - 1U] & 0x80U) != 0) ids.push_back(f.data[f.length - 1U] & 0x1F);
  }
  EXPECT_EQ(ids, (std::vector<int>{31, 0, 1, 2}));
  EXPECT_TRUE(queue.empty());
}

TEST(TxQueue, FlightGoesBeforeServiceAndKeepsRoom) {
  TxQueue queue;
  FakeBus bus;
  hal::CanFrame frame;
  frame.extended = false;
  frame.length = 1;
  int services = 0;
  while (queue.begin(TxClass::kService, 0)) {
    frame.id = 1;
    queue.add_raw(frame);
    queue.commit();
    ++services;
  }
  EXPECT_EQ(services, 16);
  ASSERT_TRUE(queue.begin(TxClass::kFlight, 0));
  frame.id = 2;
  queue.add_raw(frame);
  queue.commit();
  queue.drain(bus, 0, 100);
  EXPECT_EQ(bus.sent.front().second.id, 2U);
  EXPECT_EQ(bus.sent.size(), 17U);
  ASSERT_TRUE(queue.begin(TxClass::kFlight, 0));
  EXPECT_EQ(queue.commit(), 0U) << "an empty message is none";
}

TEST(ByteQueue, FinishesWhatBeganAndReplacesWaitingPoses) {
  ByteQueue queue;
  const std::vector<std::uint8_t> one(100, 1), two(50, 2), three(60, 3), status(10, 4);
  EXPECT_TRUE(queue.push(one, TxClass::kPose));
  queue.consume(30);
  EXPECT_TRUE(queue.push(status, TxClass::kFlight));
  EXPECT_TRUE(queue.push(two, TxClass::kPose));
  EXPECT_TRUE(queue.push(three, TxClass::kPose));
  EXPECT_EQ(queue.poses_replaced(), 1U);
  std::vector<std::uint8_t> out;
  while (!queue.front().empty()) {
    const std::size_t take = std::min<std::size_t>(7, queue.front().size());
    out.insert(out.end(), queue.front().begin(), queue.front().begin() + static_cast<std::ptrdiff_t>(take));
    queue.consume(take);
  }
  std::string expected;
  for (int i = 0; i < 70; ++i) expected += "01";
  EXPECT_EQ(to_hex(out), expected + to_hex(status) + to_hex(three));
  int fit = 0;
  while (queue.push(status, TxClass::kFlight)) ++fit;
  EXPECT_EQ(fit, 16);
  EXPECT_FALSE(queue.push(std::vector<std::uint8_t>(301), TxClass::kFlight));
}

TEST(BytePort, SaysWhatItExpected) {
  for (const char* bad :
       {"", "udp", "udp:localhost:14550", "udp:127.0.0.1:0", "udp:127.0.0.1:70000", "serial:/dev/null",
        "serial:/dev/null:12345", "serial:/nonexistent:115200", "serial:/dev/null:115200"}) {
    const auto port = open_byte_port(bad);
    ASSERT_FALSE(port.ok()) << bad;
    EXPECT_NE(port.error().message.find("MAVLink port"), std::string::npos);
  }
}

TEST(BytePort, UdpBothWays) {
  auto a = open_byte_port("udp:127.0.0.1:47121:47120"), b = open_byte_port("udp:127.0.0.1:47120:47121");
  ASSERT_TRUE(a.ok() && b.ok());
  const std::vector<std::uint8_t> message{1, 2, 3};
  EXPECT_TRUE(a.value()->send(message, TxClass::kPose));
  std::array<std::uint8_t, 16> got{};
  std::size_t size = 0;
  for (int i = 0; i < 2000 && size == 0; ++i) {
    size = b.value()->receive(got);
    if (size == 0) usleep(1000);
  }
  EXPECT_EQ(to_hex({got.data(), size}), "010203");
  EXPECT_EQ(a.value()->receive(got), 0U);
}

TEST(BytePort, SerialThroughAPseudoTerminal) {
  const int master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  ASSERT_GE(master, 0);
  ASSERT_EQ(grantpt(master), 0);
  ASSERT_EQ(unlockpt(master), 0);
  std::array<char, 64> name{};
  ASSERT_EQ(ptsname_r(master, name.data(), name.size()), 0);
  auto port = open_byte_port("serial:" + std::string(name.data()) + ":921600");
  ASSERT_TRUE(port.ok()) << port.error().message;
  const std::vector<std::uint8_t> message{0x0A, 0x0D, 0x11, 0x13, 0x00, 0xFD};  // nothing is translated or swallowed
  EXPECT_TRUE(port.value()->send(message, TxClass::kFlight));
  std::array<std::uint8_t, 16> got{};
  const ssize_t size = read(master, got.data(), got.size());
  ASSERT_EQ(size, 6);
  EXPECT_EQ(to_hex({got.data(), 6}), "0a0d111300fd");
  ASSERT_EQ(write(master, message.data(), message.size()), 6);
  EXPECT_EQ(port.value()->receive(got), 6U);
  // Nobody reads: the queue fills, poses give way, nothing blocks.
  const std::vector<std::uint8_t> pose(245, 7);
  for (int i = 0; i < 200; ++i) port.value()->send(pose, TxClass::kPose);
  close(master);
}

TEST(FrameBits, KnownFrames) {
  hal::CanFrame f;
  f.extended = false;
  f.id = 0x555;  // alternating bits
  f.length = 0;
  const double bits = frame_bits(f);
  EXPECT_GE(bits, 47);
  EXPECT_LE(bits, 52);
  f.id = 0;  // start, id, flags, length and CRC are all zeros, and each five of them get a stuff bit
  EXPECT_EQ(frame_bits(f), 47 + (1 + 11 + 3 + 4 + 15) / 5);
  f.extended = true;
  f.length = 8;
  for (auto& b : f.data) b = 0x55;
  f.id = 0x15555555;
  EXPECT_GE(frame_bits(f), 131);
  EXPECT_LE(frame_bits(f), 131 + 29);
  f.fd = true;
  f.length = 64;
  EXPECT_LT(frame_bits(f, 4), frame_bits(f, 1) / 2);
}

TEST(MavlinkParser, FindsMessagesInNoiseAndCountsWhatItPassesOver) {
  mavlink::Sender sender{1, 1, 0};
  mavlink::MessageBytes bytes;
  mavlink::Heartbeat heartbeat;
  heartbeat.custom_mode = 77;
  const std::size_t size = mavlink::encode(heartbeat, &sender, &bytes);
  std::vector<std::uint8_t> stream{0x00, 0xFD, 0x09, 0xFE};
  const auto add = [&](std::size_t flip) {
    const std::size_t at = stream.size();
    stream.insert(stream.end(), bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size));
    if (flip < size) stream[at + flip] ^= 0x10;
  };
  for (std::size_t flip = 0; flip < size; ++flip) {
    add(flip);
    add(999);
  }
  for (int i = 0; i < 15; ++i) add(999);  // pushes out what a damaged length may still wait for
  for (const std::size_t step : {std::size_t{1}, std::size_t{7}, stream.size()}) {
    mavlink::Parser parser;
    std::size_t good = 0;
    for (std::size_t at = 0; at < stream.size(); at += step) {
      parser.feed(std::span(stream).subspan(at, std::min(step, stream.size() - at)),
                  [&](const mavlink::RawMessage& raw) {
                    mavlink::Heartbeat back;
                    mavlink::decode(raw, &back);
                    EXPECT_EQ(back.custom_mode, 77U);
                    ++good;
                  });
    }
    // A flipped id makes a message we do not know, which is passed over whole.
    EXPECT_GE(good, size + 10) << step;
    EXPECT_LE(good, size + 15);
    EXPECT_GT(parser.counters().bad_crc, 10U);
    EXPECT_GT(parser.counters().unknown, 0U);
    EXPECT_GT(parser.counters().incompatible, 0U);
  }
}

TEST(Inputs, AReaderThatWasAwayHearsWhatComesNowNotWhatWas) {
  const auto ring = std::make_unique<InputRing>();
  AutopilotInput input;
  for (std::size_t i = 0; i < 2 * InputRing::capacity(); ++i) {
    input.t_arrival_ns = static_cast<rt::TimeNs>(i);
    ring->try_push(input);
  }
  EXPECT_FALSE(take_input(ring.get(), &input)) << "512 that are old";
  input.t_arrival_ns = 4000;
  ASSERT_TRUE(ring->try_push(input));
  ASSERT_TRUE(take_input(ring.get(), &input));
  EXPECT_EQ(input.t_arrival_ns, 4000);
  EXPECT_FALSE(take_input(ring.get(), &input));
}

TEST(Inputs, AreScaledAndNonsenseIsRefused) {
  mavlink::Sender sender{1, 1, 0};
  mavlink::MessageBytes bytes;
  AutopilotInput input;
  bool taken = false;
  const auto give = [&](const auto& message) {
    mavlink::Parser parser;
    const std::size_t size = mavlink::encode(message, &sender, &bytes);
    parser.feed({bytes.data(), size}, [&](const mavlink::RawMessage& raw) { taken = input_from_mavlink(raw, &input); });
    return taken;
  };
  mavlink::RawImu imu;
  imu.time_usec = 12345;
  imu.zacc = -1000;
  imu.xgyro = 500;
  ASSERT_TRUE(give(imu));
  EXPECT_EQ(input.kind, InputKind::kImu);
  EXPECT_NEAR(input.value[2], -9.80665, 1e-9);
  EXPECT_NEAR(input.value[3], 0.5, 1e-9);
  EXPECT_EQ(input.t_source_us, 12345U);
  mavlink::HighresImu high;
  EXPECT_FALSE(give(high)) << "no fields updated";
  high.fields_updated = 0x3F;
  high.yacc = std::nanf("");
  EXPECT_FALSE(give(high));
  mavlink::DistanceSensor range;
  range.min_distance = 20;
  range.max_distance = 4000;
  range.current_distance = 153;
  range.orientation = 25;
  ASSERT_TRUE(give(range));
  EXPECT_NEAR(input.value[0], 1.53, 1e-9);
  range.current_distance = 4001;
  EXPECT_FALSE(give(range)) << "out of its reach";
  mavlink::AttitudeQuaternion attitude;
  EXPECT_FALSE(give(attitude)) << "no rotation";
  mavlink::GlobalPositionInt global;
  global.lat = 473977000;
  global.lon = -85456000;
  global.alt = 488123;
  ASSERT_TRUE(give(global));
  EXPECT_NEAR(input.value[0], 47.3977, 1e-9);
  EXPECT_NEAR(input.value[1], -8.5456, 1e-9);
  EXPECT_NEAR(input.value[2], 488.123, 1e-9);
  global.lat = 1000000000;
  EXPECT_FALSE(give(global));

  std::array<std::uint8_t, dronecan::kMaxPayload> payload;
  const auto give_can = [&](const auto& message) {
    using T = std::decay_t<decltype(message)>;
    dronecan::Transfer t{
        .type_id = T::kType.id, .source = 9, .payload = {payload.data(), dronecan::encode(message, payload, false)}};
    return input_from_dronecan(t, &input);
  };
  dronecan::RangeMeasurement can_range;
  can_range.range_m = 12.5F;
  EXPECT_FALSE(give_can(can_range)) << "reading type undefined";
  can_range.reading_type = 1;
  can_range.sensor_id = 3;
  ASSERT_TRUE(give_can(can_range));
  EXPECT_EQ(input.value[0], 12.5);
  EXPECT_EQ(input.sensor, 3);
  EXPECT_EQ(input.source, 9);
  dronecan::StaticPressure pressure;
  EXPECT_FALSE(give_can(pressure));
  pressure.pressure_pa = 95000;
  pressure.variance_pa2 = std::nanf("");
  EXPECT_FALSE(give_can(pressure));
  pressure.variance_pa2 = 4;
  EXPECT_TRUE(give_can(pressure));
  dronecan::GlobalTimeSync time;
  time.previous_transmission_us = 55;
  ASSERT_TRUE(give_can(time));
  EXPECT_EQ(input.t_source_us, 55U);
}

}  // namespace parts_test
}  // namespace godwit::link
