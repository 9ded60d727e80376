#include "server/scene_digest.h"

#include <openssl/evp.h>
#include <openssl/sha.h>

#include <algorithm>
#include <memory>
#include <new>

#include "absl/strings/escaping.h"

namespace shadowfit {
namespace {

/// Between two looks at the cancellation: about a millisecond.
constexpr size_t kBytesOfPoll = size_t{1} << 20;

}  // namespace

bool IsSceneDigest(std::string_view digest) {
  return digest.size() == 2 * SHA256_DIGEST_LENGTH && std::all_of(digest.begin(), digest.end(), [](char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
         });
}

std::string SceneDigest(std::string_view data, const Cancellation* cancellation) {
  // It fails only where memory does.
  const auto check = [](int ok) {
    if (ok != 1) throw std::bad_alloc();
  };
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(), &EVP_MD_CTX_free);
  check(context != nullptr ? 1 : 0);
  check(EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr));
  while (!data.empty() && !IsCancelled(cancellation)) {
    const std::string_view piece = data.substr(0, kBytesOfPoll);
    check(EVP_DigestUpdate(context.get(), piece.data(), piece.size()));
    data.remove_prefix(piece.size());
  }
  unsigned char hash[SHA256_DIGEST_LENGTH];
  check(EVP_DigestFinal_ex(context.get(), hash, nullptr));
  return absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(hash), sizeof(hash)));
}

}  // namespace shadowfit
