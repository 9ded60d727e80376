#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <set>
#include <string>
#include <vector>

#include "google/rpc/error_details.pb.h"
#include "shadowfit/v1/optimizer.pb.h"
#include "tests/loopback/loopback.h"
#include "tests/support/wire_frame.h"

namespace shadowfit {
namespace {

using namespace std::chrono_literals;
using v1::Frame;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr uint32_t kHuge = 0x80000000U;

struct Malformed {
  const char* name;
  const char* field;  // How the message begins, up to the colon.
  std::function<void(Frame&)> change;
};

/// Lights of the good frame: 0 is a point light, 1 a spot, 2 directional.
Frame GoodFrame(uint64_t id) {
  testing::OwnedFrame owned = testing::RandomFrame(7, 12, 10, 3);
  owned.request.lights[0].light = PointLight{{1, 2, 9}};
  owned.request.lights[1].light = SpotLight{{-3, 2, 8}, {0.2, 0.1, -1}, 0.7};
  owned.request.lights[2].light = DirectionalLight{{0.3, 0.2, -1}};
  return testing::WireFrame(id, owned.request);
}

void Resize(v1::Matrix4* matrix, int entries) {
  while (matrix->m_size() < entries) matrix->add_m(1.0);
  matrix->mutable_m()->Truncate(entries);
}

v1::Matrix4* View(Frame& f) { return f.mutable_camera()->mutable_view(); }
v1::Matrix4* Projection(Frame& f) { return f.mutable_camera()->mutable_projection(); }
v1::DepthBuffer* Depth(Frame& f) { return f.mutable_depth(); }
v1::BitBuffer* Bits(Frame& f) { return f.mutable_shadow_bits(); }
v1::PointLight* Point(Frame& f) { return f.mutable_lights(0)->mutable_point(); }
v1::SpotLight* Spot(Frame& f) { return f.mutable_lights(1)->mutable_spot(); }
v1::DirectionalLight* Directional(Frame& f) { return f.mutable_lights(2)->mutable_directional(); }

v1::TexelBudget* Budget(Frame& f) {
  f.mutable_options()->mutable_texel_budget()->set_total_texels(1'000'000);
  return f.mutable_options()->mutable_texel_budget();
}

void ShrinkBits(Frame& f, uint32_t width, uint32_t height) {
  Bits(f)->set_width(width);
  Bits(f)->set_height(height);
  Bits(f)->mutable_data()->resize(size_t{width} * height * 4);
}

void GiveBounds(Frame& f, const glm::dvec3& min, const glm::dvec3& max) {
  testing::SetVector(min, f.mutable_scene_bounds()->mutable_min());
  testing::SetVector(max, f.mutable_scene_bounds()->mutable_max());
}

void GiveScreen(Frame& f, uint32_t width, uint32_t height) {
  f.mutable_screen()->set_width(width);
  f.mutable_screen()->set_height(height);
}

void GivePrevious(Frame& f, double corner, int entries) {
  testing::SetMatrix(glm::dmat4(1.0), f.mutable_lights(1)->mutable_previous_world_to_shadow_clip());
  f.mutable_lights(1)->mutable_previous_world_to_shadow_clip()->set_m(15, corner);
  Resize(f.mutable_lights(1)->mutable_previous_world_to_shadow_clip(), entries);
}

const std::vector<Malformed>& Table() {
  static const std::vector<Malformed> table = {
      {"no camera", "camera", [](Frame& f) { f.clear_camera(); }},
      {"no view", "camera.view", [](Frame& f) { f.mutable_camera()->clear_view(); }},
      {"view without entries", "camera.view.m", [](Frame& f) { Resize(View(f), 0); }},
      {"view of 15", "camera.view.m", [](Frame& f) { Resize(View(f), 15); }},
      {"view of 17", "camera.view.m", [](Frame& f) { Resize(View(f), 17); }},
      {"view with NaN", "camera.view.m[5]", [](Frame& f) { View(f)->set_m(5, kNan); }},
      {"view with infinity", "camera.view.m[12]", [](Frame& f) { View(f)->set_m(12, kInfinity); }},
      {"view of zeros", "camera.view", [](Frame& f) { testing::SetMatrix(glm::dmat4(0.0), View(f)); }},
      {"view with equal rows", "camera.view",
       [](Frame& f) {
         for (int column = 0; column < 4; ++column) View(f)->set_m(4 * column, View(f)->m(4 * column + 1));
       }},
      {"no projection", "camera.projection", [](Frame& f) { f.mutable_camera()->clear_projection(); }},
      {"projection of 15", "camera.projection.m", [](Frame& f) { Resize(Projection(f), 15); }},
      {"projection of 32", "camera.projection.m", [](Frame& f) { Resize(Projection(f), 32); }},
      {"projection with NaN", "camera.projection.m[0]", [](Frame& f) { Projection(f)->set_m(0, kNan); }},
      {"projection with -infinity", "camera.projection.m[15]",
       [](Frame& f) { Projection(f)->set_m(15, -kInfinity); }},
      {"projection with a zero row", "camera.projection",
       [](Frame& f) {
         for (int column = 0; column < 4; ++column) Projection(f)->set_m(4 * column + 1, 0.0);
       }},
      {"unknown clip depth", "camera.clip_depth",
       [](Frame& f) { f.mutable_camera()->set_clip_depth(static_cast<v1::ClipDepth>(4)); }},
      {"negative clip depth", "camera.clip_depth",
       [](Frame& f) { f.mutable_camera()->set_clip_depth(static_cast<v1::ClipDepth>(-1)); }},

      {"no depth", "depth", [](Frame& f) { f.clear_depth(); }},
      {"depth without width", "depth.width", [](Frame& f) { Depth(f)->set_width(0); }},
      {"depth without height", "depth.height", [](Frame& f) { Depth(f)->set_height(0); }},
      {"depth 2^31 wide", "depth.width", [](Frame& f) { Depth(f)->set_width(kHuge); }},
      {"depth 2^31 high", "depth.height", [](Frame& f) { Depth(f)->set_height(kHuge); }},
      {"depth 2^32-1 wide and high", "depth.width",
       [](Frame& f) {
         Depth(f)->set_width(0xFFFFFFFFU);
         Depth(f)->set_height(0xFFFFFFFFU);
       }},
      {"depth whose bytes overflow 32 bits to 0", "depth.width",
       [](Frame& f) {
         Depth(f)->set_width(65536);
         Depth(f)->set_height(65536);
         Depth(f)->clear_data();
       }},
      {"depth of the largest size and no bytes", "depth.data",
       [](Frame& f) {
         Depth(f)->set_width(16384);
         Depth(f)->set_height(16384);
         Depth(f)->clear_data();
       }},
      {"depth one too wide", "depth.width", [](Frame& f) { Depth(f)->set_width(16385); }},
      {"depth without bytes", "depth.data", [](Frame& f) { Depth(f)->clear_data(); }},
      {"depth one byte short", "depth.data", [](Frame& f) { Depth(f)->mutable_data()->pop_back(); }},
      {"depth one byte long", "depth.data", [](Frame& f) { Depth(f)->mutable_data()->push_back('x'); }},
      {"depth one row short", "depth.data", [](Frame& f) { Depth(f)->mutable_data()->resize(12 * 9 * 4); }},
      {"float32 bytes as float16", "depth.data",
       [](Frame& f) { Depth(f)->set_encoding(v1::DEPTH_ENCODING_FLOAT16); }},
      {"float32 bytes as unorm16", "depth.data",
       [](Frame& f) { Depth(f)->set_encoding(v1::DEPTH_ENCODING_UNORM16); }},
      {"three bytes a sample as unorm24", "depth.data",
       [](Frame& f) {
         Depth(f)->set_encoding(v1::DEPTH_ENCODING_UNORM24);
         Depth(f)->mutable_data()->resize(12 * 10 * 3);
       }},
      {"unknown encoding", "depth.encoding",
       [](Frame& f) { Depth(f)->set_encoding(static_cast<v1::DepthEncoding>(77)); }},
      {"unknown row order of depth", "depth.row_order",
       [](Frame& f) { Depth(f)->set_row_order(static_cast<v1::RowOrder>(3)); }},

      {"bits without width", "shadow_bits.width", [](Frame& f) { Bits(f)->set_width(0); }},
      {"bits without height", "shadow_bits.height", [](Frame& f) { Bits(f)->set_height(0); }},
      {"bits 2^31 high", "shadow_bits.height", [](Frame& f) { Bits(f)->set_height(kHuge); }},
      {"bits without bytes", "shadow_bits.data", [](Frame& f) { Bits(f)->clear_data(); }},
      {"bits one byte short", "shadow_bits.data", [](Frame& f) { Bits(f)->mutable_data()->pop_back(); }},
      {"bits of one byte a pixel", "shadow_bits.data",
       [](Frame& f) { Bits(f)->mutable_data()->resize(12 * 10); }},
      {"bits narrower than depth", "shadow_bits", [](Frame& f) { ShrinkBits(f, 11, 10); }},
      {"bits transposed", "shadow_bits", [](Frame& f) { ShrinkBits(f, 10, 12); }},
      {"unknown row order of bits", "shadow_bits.row_order",
       [](Frame& f) { Bits(f)->set_row_order(static_cast<v1::RowOrder>(42)); }},

      {"no lights", "lights", [](Frame& f) { f.clear_lights(); }},
      {"33 lights", "lights",
       [](Frame& f) {
         while (f.lights_size() < 33) {
           const uint32_t id = 1000 + static_cast<uint32_t>(f.lights_size());
           *f.add_lights() = f.lights(0);
           f.mutable_lights(f.lights_size() - 1)->set_id(id);
         }
       }},
      {"duplicate ids", "lights[2].id", [](Frame& f) { f.mutable_lights(2)->set_id(f.lights(0).id()); }},
      {"light without kind", "lights[1].kind", [](Frame& f) { f.mutable_lights(1)->clear_kind(); }},
      {"light without map", "lights[0].shadow_map",
       [](Frame& f) { f.mutable_lights(0)->clear_shadow_map(); }},
      {"map without width", "lights[0].shadow_map.width",
       [](Frame& f) { f.mutable_lights(0)->mutable_shadow_map()->set_width(0); }},
      {"map without height", "lights[2].shadow_map.height",
       [](Frame& f) { f.mutable_lights(2)->mutable_shadow_map()->set_height(0); }},
      {"map one too wide", "lights[0].shadow_map.width",
       [](Frame& f) { f.mutable_lights(0)->mutable_shadow_map()->set_width(65537); }},
      {"map 2^31 high", "lights[0].shadow_map.height",
       [](Frame& f) { f.mutable_lights(0)->mutable_shadow_map()->set_height(kHuge); }},

      {"point without position", "lights[0].point.position", [](Frame& f) { Point(f)->clear_position(); }},
      {"point at NaN", "lights[0].point.position",
       [](Frame& f) { Point(f)->mutable_position()->set_y(kNan); }},
      {"point at infinity", "lights[0].point.position",
       [](Frame& f) { Point(f)->mutable_position()->set_z(kInfinity); }},
      {"spot without position", "lights[1].spot.position", [](Frame& f) { Spot(f)->clear_position(); }},
      {"spot at NaN", "lights[1].spot.position", [](Frame& f) { Spot(f)->mutable_position()->set_x(kNan); }},
      {"spot without direction", "lights[1].spot.direction", [](Frame& f) { Spot(f)->clear_direction(); }},
      {"spot of zero direction", "lights[1].spot.direction",
       [](Frame& f) {
         testing::SetVector({0, 0, 0}, Spot(f)->mutable_direction());
       }},
      {"spot of infinite direction", "lights[1].spot.direction",
       [](Frame& f) {
         testing::SetVector({0, -kInfinity, 0}, Spot(f)->mutable_direction());
       }},
      {"spot without angle", "lights[1].spot.outer_half_angle",
       [](Frame& f) { Spot(f)->clear_outer_half_angle(); }},
      {"spot of negative angle", "lights[1].spot.outer_half_angle",
       [](Frame& f) { Spot(f)->set_outer_half_angle(-0.5); }},
      {"spot in degrees", "lights[1].spot.outer_half_angle",
       [](Frame& f) { Spot(f)->set_outer_half_angle(45.0); }},
      {"spot of a right angle", "lights[1].spot.outer_half_angle",
       [](Frame& f) { Spot(f)->set_outer_half_angle(std::acos(-1.0) / 2.0); }},
      {"spot of NaN angle", "lights[1].spot.outer_half_angle",
       [](Frame& f) { Spot(f)->set_outer_half_angle(kNan); }},
      {"sun without direction", "lights[2].directional.direction",
       [](Frame& f) { Directional(f)->clear_direction(); }},
      {"sun of zero direction", "lights[2].directional.direction",
       [](Frame& f) {
         testing::SetVector({0, -0.0, 0}, Directional(f)->mutable_direction());
       }},
      {"sun of NaN direction", "lights[2].directional.direction",
       [](Frame& f) { Directional(f)->mutable_direction()->set_x(kNan); }},
      {"previous matrix of 12", "lights[1].previous_world_to_shadow_clip.m",
       [](Frame& f) { GivePrevious(f, 1.0, 12); }},
      {"previous matrix with NaN", "lights[1].previous_world_to_shadow_clip.m[15]",
       [](Frame& f) { GivePrevious(f, kNan, 16); }},
      {"previous matrix with infinity", "lights[1].previous_world_to_shadow_clip.m[15]",
       [](Frame& f) { GivePrevious(f, kInfinity, 16); }},

      {"screen without size", "screen.width", [](Frame& f) { GiveScreen(f, 0, 0); }},
      {"screen without height", "screen.height", [](Frame& f) { GiveScreen(f, 5, 0); }},
      {"screen 2^31 wide", "screen.width", [](Frame& f) { GiveScreen(f, kHuge, 5); }},
      {"bounds without min", "scene_bounds.min",
       [](Frame& f) {
         testing::SetVector({1, 1, 1}, f.mutable_scene_bounds()->mutable_max());
       }},
      {"bounds without max", "scene_bounds.max",
       [](Frame& f) {
         testing::SetVector({1, 1, 1}, f.mutable_scene_bounds()->mutable_min());
       }},
      {"bounds inside out", "scene_bounds",
       [](Frame& f) {
         GiveBounds(f, {0, 2, 0}, {1, 1, 1});
       }},
      {"bounds with NaN", "scene_bounds",
       [](Frame& f) {
         GiveBounds(f, {0, kNan, 0}, {1, 1, 1});
       }},
      {"bounds with infinity", "scene_bounds",
       [](Frame& f) {
         GiveBounds(f, {0, 0, 0}, {1, 1, kInfinity});
       }},
      {"more maps a light than there are cube faces", "options.most_maps",
       [](v1::Frame& f) { f.mutable_options()->set_most_maps(7); }},
      {"unknown method", "options.method",
       [](Frame& f) { f.mutable_options()->set_method(static_cast<v1::Method>(99)); }},
      {"keep_within below 1", "options.keep_within",
       [](Frame& f) { f.mutable_options()->set_keep_within(0.99); }},
      {"negative keep_within", "options.keep_within",
       [](Frame& f) { f.mutable_options()->set_keep_within(-1.5); }},
      {"keep_within of NaN", "options.keep_within",
       [](Frame& f) { f.mutable_options()->set_keep_within(kNan); }},
      {"keep_within of infinity", "options.keep_within",
       [](Frame& f) { f.mutable_options()->set_keep_within(kInfinity); }},
      {"previous map of no width", "lights[1].previous_shadow_map.width",
       [](Frame& f) { f.mutable_lights(1)->mutable_previous_shadow_map()->set_height(64); }},
      {"previous map of 2^31 rows", "lights[0].previous_shadow_map.height",
       [](Frame& f) {
         f.mutable_lights(0)->mutable_previous_shadow_map()->set_width(64);
         f.mutable_lights(0)->mutable_previous_shadow_map()->set_height(kHuge);
       }},
      {"light of weight 0", "lights[1].weight", [](Frame& f) { f.mutable_lights(1)->set_weight(0.0); }},
      {"light of NaN weight", "lights[0].weight", [](Frame& f) { f.mutable_lights(0)->set_weight(kNan); }},
      {"budget of nothing", "options.texel_budget.total_texels",
       [](Frame& f) { f.mutable_options()->mutable_texel_budget(); }},
      {"budget of three texels", "options.texel_budget.total_texels",
       [](Frame& f) { f.mutable_options()->mutable_texel_budget()->set_total_texels(3); }},
      {"budget of sides 2^31", "options.texel_budget.sides.max_side",
       [](Frame& f) { Budget(f)->mutable_sides()->set_max_side(kHuge); }},
      {"budget of sides the wrong way round", "options.texel_budget.sides.min_side",
       [](Frame& f) {
         Budget(f)->mutable_sides()->set_min_side(200);
         Budget(f)->mutable_sides()->set_max_side(100);
       }},
      {"budget of multiples of 8 from 4 on", "options.texel_budget.sides.min_side",
       [](Frame& f) {
         Budget(f)->mutable_sides()->set_min_side(4);
         Budget(f)->mutable_sides()->set_rounding(v1::SIZE_ROUNDING_MULTIPLE_OF_8);
       }},
      {"budget of unknown rounding", "options.texel_budget.sides.rounding",
       [](Frame& f) { Budget(f)->mutable_sides()->set_rounding(static_cast<v1::SizeRounding>(9)); }},
      {"atlas without height", "options.texel_budget.atlas.height",
       [](Frame& f) { Budget(f)->mutable_atlas()->set_width(64); }},
      {"atlas too small", "options.texel_budget.atlas",
       [](Frame& f) {
         Budget(f)->mutable_atlas()->set_width(20);
         Budget(f)->mutable_atlas()->set_height(20);
       }},
      {"tolerance of nothing", "options.tolerance.max_misclassified_pixels",
       [](Frame& f) { f.mutable_options()->mutable_tolerance(); }},
      {"tolerance of infinity", "options.tolerance.max_misclassified_pixels",
       [](Frame& f) { f.mutable_options()->mutable_tolerance()->set_max_misclassified_pixels(kInfinity); }},
      {"tolerance of sides 65537", "options.tolerance.sides.min_side",
       [](Frame& f) {
         f.mutable_options()->mutable_tolerance()->set_max_misclassified_pixels(10.0);
         f.mutable_options()->mutable_tolerance()->mutable_sides()->set_min_side(65537);
       }},
      {"unknown output convention", "options.output_clip_depth",
       [](Frame& f) { f.mutable_options()->set_output_clip_depth(static_cast<v1::ClipDepth>(-7)); }},
  };
  return table;
}

std::string ViolatedField(const absl::Status& status) {
  const auto payload = status.GetPayload("type.googleapis.com/google.rpc.BadRequest");
  google::rpc::BadRequest bad_request;
  if (!payload || !bad_request.ParseFromString(std::string(*payload))) return "";
  return bad_request.field_violations_size() == 1 ? bad_request.field_violations(0).field() : "";
}

void ExpectNames(const absl::Status& status, const Malformed& malformed, const std::string& service) {
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << status;
  const std::string start = service + ": " + malformed.field + ": ";
  EXPECT_EQ(std::string(status.message()).substr(0, start.size()), start);
  EXPECT_GT(status.message().size(), start.size()) << "the message says nothing of what is wrong";
  EXPECT_EQ(ViolatedField(status), std::string("frame.") + malformed.field);
}

TEST(MalformedFrames, TheTableIsLongAndItsNamesDiffer) {
  std::set<std::string> names;
  for (const Malformed& malformed : Table()) names.insert(malformed.name);
  EXPECT_EQ(names.size(), Table().size());
  EXPECT_GE(names.size(), 60U);
}

TEST(MalformedFrames, TheUnchangedFrameIsGood) {
  const testing::Loopback loopback;
  const auto result = loopback.ConnectInProcess()->Optimize(GoodFrame(1));
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(result->lights_size(), 3);
}

TEST(MalformedFrames, UnaryCallsNameTheField) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  for (const Malformed& malformed : Table()) {
    SCOPED_TRACE(malformed.name);
    Frame frame = GoodFrame(1);
    malformed.change(frame);
    ExpectNames(client->Optimize(frame).status(), malformed, client->name());
  }
}

TEST(MalformedFrames, AStreamNamesTheFieldAndAnswersTheNextGoodFrame) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  const auto stream = client->OpenStream();
  uint64_t id = 0;
  const auto send = [&](const Frame& frame) {
    Frame* slot = stream->Acquire();
    ASSERT_NE(slot, nullptr);
    *slot = frame;
    ASSERT_TRUE(stream->Submit(slot).ok());
  };
  std::string good_matrices;
  for (const Malformed& malformed : Table()) {
    SCOPED_TRACE(malformed.name);
    Frame frame = GoodFrame(++id);
    malformed.change(frame);
    send(frame);
    send(GoodFrame(++id));
    const auto bad = stream->Wait(5s);
    ASSERT_TRUE(bad.has_value());
    EXPECT_EQ(bad->frame_id, id - 1);
    ExpectNames(bad->result.status(), malformed, client->name());
    const auto good = stream->Wait(5s);
    ASSERT_TRUE(good.has_value());
    EXPECT_EQ(good->frame_id, id);
    ASSERT_TRUE(good->result.ok()) << good->result.status();
    ASSERT_EQ(good->result->lights_size(), 3);
    for (const v1::LightResult& light : good->result->lights()) {
      for (const double entry : light.world_to_shadow_clip().m()) EXPECT_TRUE(std::isfinite(entry));
    }
  }
  EXPECT_TRUE(stream->Finish(5s).ok());
}

// Requests that the generated client cannot make: a frame that is missing, bytes that are no message at all.
TEST(MalformedFrames, ARequestWithoutAFrameIsRefused) {
  const testing::Loopback loopback;
  std::string response;
  const grpc::Status status = testing::CallRaw(loopback.Connect()->channel(),
                                               "/shadowfit.v1.OptimizerService/Optimize", "", &response);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(status.error_message(), "frame: missing");
}

TEST(MalformedFrames, BytesThatAreNoMessageHarmNobody) {
  const testing::Loopback loopback;
  const auto client = loopback.Connect();
  std::mt19937 random(3);
  const std::string good = [] {
    v1::OptimizeRequest request;
    *request.mutable_frame() = GoodFrame(1);
    return request.SerializeAsString();
  }();
  int refused = 0;
  for (int i = 0; i < 300; ++i) {
    std::string bytes = good;
    if (i % 3 == 0) bytes.resize(random() % bytes.size());
    for (int k = 0; k < 8; ++k) bytes[random() % bytes.size()] = static_cast<char>(random());
    std::string response;
    const grpc::Status status =
        testing::CallRaw(client->channel(), "/shadowfit.v1.OptimizerService/Optimize", bytes, &response);
    if (!status.ok()) ++refused;
    EXPECT_NE(status.error_code(), grpc::StatusCode::UNAVAILABLE) << status.error_message();
    EXPECT_NE(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED) << status.error_message();
  }
  EXPECT_GT(refused, 100);
  EXPECT_TRUE(client->Optimize(GoodFrame(1)).ok());
}

}  // namespace
}  // namespace shadowfit
