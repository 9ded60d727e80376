#include "client/packed_scene.h"

#include <openssl/sha.h>

#include "absl/strings/escaping.h"

namespace shadowfit {

PackedScene PackScene(const v1::SceneData& scene) {
  PackedScene packed;
  scene.SerializeToString(&packed.bytes);
  unsigned char hash[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const unsigned char*>(packed.bytes.data()), packed.bytes.size(), hash);
  packed.digest =
      absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(hash), sizeof(hash)));
  return packed;
}

}  // namespace shadowfit
