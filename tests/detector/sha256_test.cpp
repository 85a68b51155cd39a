#include "detector/sha256.h"

#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/support/temp_folder.h"

namespace godwit::detector::sha256_test {
namespace {

std::string of(const std::string& text, std::size_t piece) {
  Sha256 sum;
  for (std::size_t at = 0; at < text.size(); at += piece) {
    const std::string part = text.substr(at, piece);
    sum.add({reinterpret_cast<const std::uint8_t*>(part.data()), part.size()});
  }
  return sum.digits();
}

// Examples of FIPS 180-4 and of the NIST's test vectors, in pieces of any size.
TEST(Sha256, TheStandardsExamples) {
  for (const std::size_t piece : {1, 7, 63, 64, 65, 100'000}) {
    EXPECT_EQ(of("", piece), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    EXPECT_EQ(of("abc", piece), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    EXPECT_EQ(of("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", piece),
              "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    EXPECT_EQ(of(std::string(1'000'000, 'a'), piece),
              "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  }
}

TEST(Sha256, OfAFileAndNotOfAPipeNorOfWhatIsTooLarge) {
  const test::TempFolder folder;
  std::ofstream(folder / "abc") << "abc";
  EXPECT_EQ(sha256_of_file(folder / "abc").value(), of("abc", 3));
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  const auto pipe = sha256_of_file(folder / "pipe");
  ASSERT_FALSE(pipe.ok());
  EXPECT_EQ(pipe.error().message, (folder / "pipe") + ": no plain file");
  EXPECT_FALSE(sha256_of_file(folder / "none").ok());
  std::ofstream(folder / "huge") << "all of it a hole";
  std::filesystem::resize_file(folder / "huge", 1ULL << 36U);  // would be read for minutes, deaf to signals
  const auto huge = sha256_of_file(folder / "huge");
  ASSERT_FALSE(huge.ok());
  EXPECT_EQ(huge.error().message, (folder / "huge") + ": larger than 512 MiB, no network");
}

}  // namespace
}  // namespace godwit::detector::sha256_test
