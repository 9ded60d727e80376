#include "server/scene_upload.h"

#include <chrono>
#include <exception>
#include <limits>
#include <utility>

#include "absl/strings/str_format.h"
#include "proto/scene_upload_metadata.h"
#include "server/errors.h"
#include "server/request_deadline.h"
#include "server/scene_decoder.h"
#include "server/scene_digest.h"
#include "server/scene_encoding.h"

namespace shadowfit {
namespace {

constexpr char kMethod[] = "UploadScene";

absl::Status FieldError(const char* path, const std::string& what) {
  return absl::InvalidArgumentError(std::string(path) + ": " + what);
}

}  // namespace

grpc::ServerReadReactor<v1::UploadSceneRequest>* SceneUpload::Start(grpc::CallbackServerContext* call,
                                                                    ServiceContext& context,
                                                                    v1::UploadSceneResponse* response) {
  auto upload = std::make_shared<SceneUpload>(call, context, response);
  upload->self_ = upload;
  upload->StartRead(&upload->chunk_);
  return upload.get();
}

SceneUpload::SceneUpload(grpc::CallbackServerContext* call, ServiceContext& context,
                         v1::UploadSceneResponse* response)
    : call_(call), context_(context), response_(response), cancellation_(CallDeadline(*call)) {}

void SceneUpload::OnDone() { const auto keep = std::move(self_); }

void SceneUpload::OnReadDone(bool ok) {
  if (!ok) {  // The client has sent all, or is gone.
    if (!begun_) return FinishWith(FieldError("digest", "missing, the first message must name it"));
    if (bytes_.size() < total_bytes_) {
      return FinishWith(FieldError(
          "total_bytes",
          absl::StrFormat("%d announced, but the upload ended after %d", total_bytes_, bytes_.size())));
    }
    return context_.pool.Submit([upload = shared_from_this()] { upload->Store(); });
  }
  if (const absl::Status status = Receive(); !status.ok() || response_->existed()) return FinishWith(status);
  StartRead(&chunk_);
}

absl::Status SceneUpload::Begin() {
  begun_ = true;
  digest_ = chunk_.digest();
  total_bytes_ = chunk_.total_bytes();
  if (!IsSceneDigest(digest_)) {
    return FieldError("digest", absl::StrFormat("%d characters, 64 lower-case hexadecimal digits expected",
                                                digest_.size()));
  }
  if (const SceneStore::Handle scene = context_.scenes.Find(digest_)) {
    response_->set_existed(true);
    EncodeSceneInfo({scene, 0}, response_->mutable_scene());
    return absl::OkStatus();
  }
  if (total_bytes_ < 1 || total_bytes_ > std::numeric_limits<int>::max()) {
    return FieldError("total_bytes", absl::StrFormat("%d is outside 1 to %d", total_bytes_,
                                                     std::numeric_limits<int>::max()));
  }
  absl::StatusOr<Admission::Ticket> ticket = context_.admission.Admit(total_bytes_);
  if (!ticket.ok()) return ticket.status();
  ticket_ = *std::move(ticket);
  bytes_.reserve(total_bytes_);
  call_->AddInitialMetadata(kSceneWantedKey, "1");
  StartSendInitialMetadata();
  return absl::OkStatus();
}

absl::Status SceneUpload::Receive() {
  context_.metrics.CountReceivedBytes(kMethod, chunk_.data().size());
  if (!begun_) {
    if (absl::Status status = Begin(); !status.ok() || response_->existed()) return status;
  }
  if (chunk_.data().size() > total_bytes_ - bytes_.size()) {
    return FieldError(
        "data", absl::StrFormat("%d bytes, but only %d of the %d announced were left", chunk_.data().size(),
                                total_bytes_ - bytes_.size(), total_bytes_));
  }
  bytes_ += chunk_.data();
  return absl::OkStatus();
}

void SceneUpload::Store() {
  const auto start = Cancellation::Clock::now();
  absl::Status status;
  try {
    status = TryStore();
  } catch (const std::exception& error) {  // Out of memory, from a library: this request's misfortune alone.
    status = absl::InternalError(error.what());
  }
  const auto seconds = [](auto duration) { return std::chrono::duration<double>(duration).count(); };
  context_.metrics.ObserveWork(kMethod, seconds(start - arrival_),
                               seconds(Cancellation::Clock::now() - start));
  ticket_ = {};
  FinishWith(status);
}

absl::Status SceneUpload::TryStore() {
  const std::string digest = SceneDigest(bytes_, &cancellation_);
  if (absl::Status status = CancellationStatus(&cancellation_, "the upload"); !status.ok()) return status;
  if (digest != digest_) {
    return FieldError("digest", absl::StrFormat("%s, but the bytes have %s", digest_, digest));
  }
  absl::StatusOr<Scene> scene = DecodeScene(std::exchange(bytes_, {}), &cancellation_);
  if (!scene.ok()) return scene.status();
  if (absl::Status status = Validate(*scene, &cancellation_); !status.ok()) return status;
  // Few bytes can describe very many triangles, each mesh placed many times: room first, then memory.
  absl::StatusOr<SceneStore::Room> room = context_.scenes.TakeRoom(MaskScene::MostBytes(*scene));
  if (!room.ok()) return room.status();
  absl::StatusOr<MaskScene> mask_scene = MaskScene::Create(*scene, &cancellation_);
  if (!mask_scene.ok()) return mask_scene.status();
  room->ShrinkTo(mask_scene->MemoryBytes());
  const SceneStore::Handle stored = context_.scenes.Insert(digest_, *std::move(mask_scene), *std::move(room));
  EncodeSceneInfo({stored, 0}, response_->mutable_scene());
  return absl::OkStatus();
}

void SceneUpload::FinishWith(const absl::Status& status) {
  context_.metrics.CountAnswer(kMethod, status.code());
  Finish(GrpcFromStatus(WithFieldViolation(status, "")));
}

}  // namespace shadowfit
