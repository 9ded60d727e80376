#include "client/cli/frame_files.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "tests/support/wire_frame.h"
// Behind Protobuf, whose headers need byte-swap macros that OpenImageIO takes away.
#include "tests/support/write_exr.h"

namespace shadowfit {
namespace {

using testing::WriteExr;

class FrameFiles : public ::testing::Test {
 protected:
  FrameFiles() {
    char folder[] = "/tmp/shadowfit_frame_files_XXXXXX";
    folder_ = mkdtemp(folder);
    owned_ = testing::RandomFrame(21, 19, 13, 32);
    for (size_t i = 0; i < owned_.bits.size(); i += 7) owned_.bits[i] ^= 0x80000001U;
    frame_ = testing::WireFrame(77, owned_.request, v1::DEPTH_ENCODING_UNSPECIFIED, v1::ROW_ORDER_TOP_FIRST);
    v1::Frame without_buffers = frame_;
    without_buffers.clear_depth();
    without_buffers.clear_shadow_bits();
    Write("frame.json", JsonFromMessage(without_buffers));
    WriteExr(Path("depth.exr"), OIIO::TypeDesc::FLOAT, owned_.request.depth);
    WriteExr(Path("bits.exr"), OIIO::TypeDesc::UINT32, *owned_.request.bits);
  }
  ~FrameFiles() override { std::filesystem::remove_all(folder_); }

  std::string Path(const std::string& name) const { return folder_ + "/" + name; }
  void Write(const std::string& name, const std::string& text) const { std::ofstream(Path(name)) << text; }

  void ExpectError(const std::string& json, const std::string& depth, const std::string& bits,
                   const std::string& part) const {
    const auto frame = ReadFrameFiles(Path(json), Path(depth), Path(bits));
    ASSERT_FALSE(frame.ok()) << part;
    EXPECT_NE(frame.status().message().find(part), absl::string_view::npos) << frame.status();
  }

  std::string folder_;
  testing::OwnedFrame owned_;
  v1::Frame frame_;
};

TEST_F(FrameFiles, AFrameComesBackByteForByte) {
  const auto frame = ReadFrameFiles(Path("frame.json"), Path("depth.exr"), Path("bits.exr"));
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_EQ(frame->SerializeAsString(), frame_.SerializeAsString());
}

TEST_F(FrameFiles, BitsMayBeLeftOut) {
  const auto frame = ReadFrameFiles(Path("frame.json"), Path("depth.exr"), "");
  ASSERT_TRUE(frame.ok()) << frame.status();
  EXPECT_FALSE(frame->has_shadow_bits());
  EXPECT_EQ(frame->depth().data(), frame_.depth().data());
}

TEST_F(FrameFiles, ErrorsNameTheFile) {
  ExpectError("absent.json", "depth.exr", "bits.exr", "absent.json: cannot be opened");
  ExpectError("frame.json", "absent.exr", "bits.exr", "absent.exr: ");
  ExpectError("frame.json", "depth.exr", "absent.exr", "absent.exr: ");
  Write("text.json", "{\"camera\": 5");
  ExpectError("text.json", "depth.exr", "bits.exr", "text.json: ");
  Write("unknown.json", "{\"cammera\": {}}");
  ExpectError("unknown.json", "depth.exr", "bits.exr", "cammera");
  Write("buffers.json", "{\"depth\": {\"width\": 1}}");
  ExpectError("buffers.json", "depth.exr", "bits.exr", "buffers.json: holds a depth or bit buffer");
  ExpectError("frame.json", "bits.exr", "bits.exr", "bits.exr: samples are uint, float expected");
  ExpectError("frame.json", "depth.exr", "depth.exr", "depth.exr: samples are float, uint expected");
  Write("noise.exr", "not a picture");
  ExpectError("frame.json", "noise.exr", "bits.exr", "noise.exr: ");
  const auto output = OIIO::ImageOutput::create(Path("colour.exr"));
  const std::vector<float> pixels(12, 0.5F);
  ASSERT_TRUE(output->open(Path("colour.exr"), OIIO::ImageSpec(2, 2, 3, OIIO::TypeDesc::FLOAT)));
  ASSERT_TRUE(output->write_image(OIIO::TypeDesc::FLOAT, pixels.data()) && output->close());
  ExpectError("frame.json", "colour.exr", "bits.exr", "colour.exr: 3 channels (R, G, B), one expected");
}

TEST_F(FrameFiles, ATruncatedPictureIsAnError) {
  const auto size = std::filesystem::file_size(Path("depth.exr"));
  std::filesystem::resize_file(Path("depth.exr"), size / 2);
  ExpectError("frame.json", "depth.exr", "bits.exr", "depth.exr: ");
}

TEST(MethodNames, AreThoseOfTheWire) {
  const std::vector<std::string> names = MethodNames();
  EXPECT_EQ(names.front(), "default");
  for (const std::string& name : names) {
    const auto method = WireMethodFromName(name);
    ASSERT_TRUE(method.ok());
    EXPECT_NE(*method, v1::METHOD_UNSPECIFIED);
  }
  EXPECT_FALSE(WireMethodFromName("unheard").ok());
  EXPECT_FALSE(WireMethodFromName("").ok());
}

}  // namespace
}  // namespace shadowfit
