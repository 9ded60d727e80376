#pragma once

#include <google/protobuf/message.h>

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

/// A frame from files. `frame_json` is the Protobuf JSON form of shadowfit.v1.Frame without its buffers;
/// `depth_exr` holds one channel of floats, window depth in [0,1]; `bits_exr` one channel of uint32, or is
/// empty where there are no bits. Row 0 of pictures is at the top. Errors begin with the file's name.
absl::StatusOr<v1::Frame> ReadFrameFiles(const std::string& frame_json, const std::string& depth_exr,
                                         const std::string& bits_exr);

/// The Protobuf JSON form of a message, indented, with fields that hold their default.
std::string JsonFromMessage(const google::protobuf::Message& message);

absl::Status WriteTextFile(const std::string& path, const std::string& text);

/// The names that --method takes: those of the wire's enumeration in lower case.
std::vector<std::string> MethodNames();
absl::StatusOr<v1::Method> WireMethodFromName(const std::string& name);

}  // namespace shadowfit
