#include "server/scene_service.h"

#include "absl/strings/str_format.h"
#include "server/errors.h"
#include "server/scene_digest.h"
#include "server/scene_encoding.h"
#include "server/scene_upload.h"

namespace shadowfit {
namespace {

constexpr int kMaxDigests = 1000;

absl::Status CheckDigest(const std::string& digest, const std::string& path) {
  if (IsSceneDigest(digest)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%s: %d characters, 64 lower-case hexadecimal digits expected", path, digest.size()));
}

/// These calls only look something up, and are answered at once.
grpc::ServerUnaryReactor* Answer(grpc::CallbackServerContext* call, ServiceContext& context,
                                 const char* method, const absl::Status& status) {
  context.metrics.CountAnswer(method, status.code());
  grpc::ServerUnaryReactor* reactor = call->DefaultReactor();
  reactor->Finish(GrpcFromStatus(WithFieldViolation(status, "")));
  return reactor;
}

absl::Status FindMissing(SceneStore& scenes, const v1::FindMissingScenesRequest& request,
                         v1::FindMissingScenesResponse* response) {
  if (request.digests_size() > kMaxDigests) {
    return absl::InvalidArgumentError(absl::StrFormat("digests: %d, at most %d may be asked for at a time",
                                                      request.digests_size(), kMaxDigests));
  }
  for (int i = 0; i < request.digests_size(); ++i) {
    const std::string& digest = request.digests(i);
    if (absl::Status status = CheckDigest(digest, absl::StrFormat("digests[%d]", i)); !status.ok())
      return status;
    if (scenes.Find(digest) == nullptr) response->add_missing_digests(digest);
  }
  return absl::OkStatus();
}

absl::Status Delete(SceneStore& scenes, const std::string& digest) {
  if (absl::Status status = CheckDigest(digest, "digest"); !status.ok()) return status;
  if (scenes.Erase(digest)) return absl::OkStatus();
  return absl::NotFoundError(absl::StrFormat("digest: no scene %s here", digest));
}

}  // namespace

grpc::ServerUnaryReactor* SceneServiceImpl::FindMissingScenes(grpc::CallbackServerContext* call,
                                                              const v1::FindMissingScenesRequest* request,
                                                              v1::FindMissingScenesResponse* response) {
  return Answer(call, context_, "FindMissingScenes", FindMissing(context_.scenes, *request, response));
}

grpc::ServerReadReactor<v1::UploadSceneRequest>* SceneServiceImpl::UploadScene(
    grpc::CallbackServerContext* call, v1::UploadSceneResponse* response) {
  return SceneUpload::Start(call, context_, response);
}

grpc::ServerUnaryReactor* SceneServiceImpl::ListScenes(grpc::CallbackServerContext* call,
                                                       const v1::ListScenesRequest*,
                                                       v1::ListScenesResponse* response) {
  for (const SceneStore::Entry& entry : context_.scenes.List())
    EncodeSceneInfo(entry, response->add_scenes());
  response->set_bytes(context_.scenes.bytes());
  response->set_quota_bytes(context_.scenes.quota_bytes());
  return Answer(call, context_, "ListScenes", absl::OkStatus());
}

grpc::ServerUnaryReactor* SceneServiceImpl::DeleteScene(grpc::CallbackServerContext* call,
                                                        const v1::DeleteSceneRequest* request,
                                                        v1::DeleteSceneResponse*) {
  return Answer(call, context_, "DeleteScene", Delete(context_.scenes, request->digest()));
}

}  // namespace shadowfit
