#include "client/cli/frame_files.h"

#include <OpenImageIO/imageio.h>
#include <google/protobuf/util/json_util.h>

#include <fstream>
#include <iterator>
#include <memory>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace shadowfit {
namespace {

constexpr char kMethodPrefix[] = "METHOD_";

absl::StatusOr<std::string> ReadTextFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, ": cannot be opened"));
  std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (file.bad()) return absl::DataLossError(absl::StrCat(path, ": cannot be read"));
  return text;
}

/// Reads the only channel of a picture into `buffer`, as the type that it has in the file: a conversion would
/// send integers through float and lose their low bits.
template <typename Buffer>
absl::Status ReadChannel(const std::string& path, const OIIO::TypeDesc& type, Buffer& buffer) {
  const std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::open(path);
  if (input == nullptr) return absl::NotFoundError(absl::StrCat(path, ": ", OIIO::geterror()));
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.nchannels != 1) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", spec.nchannels, " channels (",
                                                   absl::StrJoin(spec.channelnames, ", "),
                                                   "), one expected"));
  }
  if (spec.format != type) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": samples are ", spec.format.c_str(), ", ", type.c_str(), " expected"));
  }
  buffer.set_width(static_cast<uint32_t>(spec.width));
  buffer.set_height(static_cast<uint32_t>(spec.height));
  buffer.set_row_order(v1::ROW_ORDER_TOP_FIRST);
  std::string& data = *buffer.mutable_data();
  data.resize(static_cast<size_t>(spec.image_pixels()) * type.size());
  if (!input->read_image(0, 0, 0, 1, type, data.data())) {
    return absl::DataLossError(absl::StrCat(path, ": ", input->geterror()));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<v1::Frame> ReadFrameFiles(const std::string& frame_json, const std::string& depth_exr,
                                         const std::string& bits_exr) {
  const absl::StatusOr<std::string> json = ReadTextFile(frame_json);
  if (!json.ok()) return json.status();
  v1::Frame frame;
  const auto parsed = google::protobuf::util::JsonStringToMessage(*json, &frame);
  if (!parsed.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(frame_json, ": ", std::string(parsed.message())));
  }
  if (frame.has_depth() || frame.has_shadow_bits()) {
    return absl::InvalidArgumentError(
        absl::StrCat(frame_json, ": holds a depth or bit buffer; those are read from pictures of their own"));
  }
  absl::Status status = ReadChannel(depth_exr, OIIO::TypeDesc::FLOAT, *frame.mutable_depth());
  if (!bits_exr.empty()) {
    status.Update(ReadChannel(bits_exr, OIIO::TypeDesc::UINT32, *frame.mutable_shadow_bits()));
  }
  if (!status.ok()) return status;
  return frame;
}

std::string JsonFromMessage(const google::protobuf::Message& message) {
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = true;
  options.always_print_primitive_fields = true;
  std::string json;
  const auto printed = google::protobuf::util::MessageToJsonString(message, &json, options);
  return printed.ok() ? json : std::string(printed.message());
}

absl::Status WriteTextFile(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  return file ? absl::OkStatus() : absl::UnavailableError(absl::StrCat(path, ": cannot be written"));
}

std::vector<std::string> MethodNames() {
  std::vector<std::string> names;
  const google::protobuf::EnumDescriptor* methods = v1::Method_descriptor();
  for (int i = 0; i < methods->value_count(); ++i) {
    if (methods->value(i)->number() == v1::METHOD_UNSPECIFIED) continue;
    names.push_back(absl::AsciiStrToLower(methods->value(i)->name().substr(sizeof(kMethodPrefix) - 1)));
  }
  return names;
}

absl::StatusOr<v1::Method> WireMethodFromName(const std::string& name) {
  v1::Method method = v1::METHOD_UNSPECIFIED;
  if (v1::Method_Parse(absl::StrCat(kMethodPrefix, absl::AsciiStrToUpper(name)), &method)) return method;
  return absl::InvalidArgumentError(
      absl::StrCat("method: \"", name, "\" is none of ", absl::StrJoin(MethodNames(), ", ")));
}

}  // namespace shadowfit
