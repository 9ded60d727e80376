#pragma once

#include "absl/status/status.h"
#include "core/fit/frame_optimizer.h"
#include "core/fit/options.h"
#include "server/field_decoding.h"
#include "shadowfit/v1/frame.pb.h"

namespace shadowfit {

/// Turns wire frames into core's requests. Keeps memory between calls: use one a stream.
class FrameDecoder {
 public:
  enum class MapSizes {
    kRequired,
    kOptional,  ///< A light without one has size 0x0.
  };

  explicit FrameDecoder(MapSizes map_sizes = MapSizes::kRequired) : map_sizes_(map_sizes) {}

  /// `request` borrows pictures from `frame` and from this decoder, until either changes. Checks what only
  /// the wire can get wrong: presence, sizes, byte counts, enumerations; what numbers mean is core's to
  /// check. InvalidArgument begins with the field's path within the frame.
  absl::Status Decode(const v1::Frame& frame, FrameRequest* request, Options* options);

 private:
  const MapSizes map_sizes_;
  DepthDecoder depth_;
};

}  // namespace shadowfit
