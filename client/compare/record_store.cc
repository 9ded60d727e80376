#include "client/compare/record_store.h"

#include <system_error>
#include <utility>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

nlohmann::json JsonOf(const RecordStore::Line& line) {
  nlohmann::json json = {{"set", LightPlacementName(line.placement)},
                         {"light", line.index},
                         {"method", line.method},
                         {"concernedPixels", line.concerned_pixels},
                         {"shadowedPixels", line.shadowed_pixels},
                         {"wrongPixels", line.record.wrong_pixels},
                         {"predictedPixels", line.record.predicted_pixels},
                         {"milliseconds", line.record.milliseconds},
                         {"boundarySamples", line.record.boundary_samples},
                         {"evaluations", line.record.evaluations},
                         {"note", line.record.note}};
  if (line.record.artefacts) {
    const ArtefactRecord& artefacts = *line.record.artefacts;
    json["artefacts"] = {{"acne", artefacts.counts.acne},
                         {"detached", artefacts.counts.peter_panning},
                         {"jagged", artefacts.counts.jagged},
                         {"flicker", artefacts.flicker}};
  }
  if (line.record.certificate) {
    const CertificateRecord& certificate = *line.record.certificate;
    json["certificate"] = {{"tolerance", certificate.tolerance}, {"timeLimit", certificate.time_limit},
                           {"complete", certificate.complete},   {"leastGap", certificate.least_gap},
                           {"mostGap", certificate.most_gap},    {"seconds", certificate.seconds}};
  }
  return json;
}

/// None where the text is not a whole line, as after an interruption.
std::optional<RecordStore::Line> LineOf(const std::string& text) {
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (json.is_discarded() || !json.is_object()) return std::nullopt;
  try {
    const auto placement = LightPlacementFromName(json.at("set").get<std::string>());
    if (!placement) return std::nullopt;
    RecordStore::Line line;
    line.placement = *placement;
    line.index = json.at("light");
    line.method = json.at("method");
    line.concerned_pixels = json.at("concernedPixels");
    line.shadowed_pixels = json.at("shadowedPixels");
    line.record.wrong_pixels = json.at("wrongPixels");
    line.record.predicted_pixels = json.at("predictedPixels");
    line.record.milliseconds = json.at("milliseconds");
    line.record.boundary_samples = json.at("boundarySamples");
    line.record.evaluations = json.at("evaluations");
    line.record.note = json.at("note");
    if (json.contains("artefacts")) {
      const nlohmann::json& kept = json.at("artefacts");
      ArtefactRecord& artefacts = line.record.artefacts.emplace();
      artefacts.counts.acne = kept.at("acne");
      artefacts.counts.peter_panning = kept.at("detached");
      artefacts.counts.jagged = kept.at("jagged");
      artefacts.flicker = kept.at("flicker");
    }
    if (json.contains("certificate")) {
      const nlohmann::json& kept = json.at("certificate");
      line.record.certificate =
          CertificateRecord{kept.at("tolerance"), kept.at("timeLimit"), kept.at("complete"),
                            kept.at("leastGap"),  kept.at("mostGap"),   kept.at("seconds")};
    }
    return line;
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  }
}

absl::Status CheckStudy(const std::filesystem::path& path, const nlohmann::json& study) {
  std::ifstream file(path);
  const nlohmann::json kept = nlohmann::json::parse(file, nullptr, /*allow_exceptions=*/false);
  if (kept == study) return absl::OkStatus();
  std::string field = "the file is damaged";
  if (kept.is_object()) {
    for (const auto& [key, value] : study.items()) {
      if (kept.contains(key) && kept.at(key) == value) continue;
      field = absl::StrFormat("\"%s\" is %s there, %s here", key,
                              kept.contains(key) ? kept.at(key).dump() : "missing", value.dump());
      break;
    }
  }
  return absl::FailedPreconditionError(
      absl::StrFormat("%s belongs to another comparison: %s; choose another folder", path.string(), field));
}

}  // namespace

absl::StatusOr<RecordStore> RecordStore::Open(const std::filesystem::path& folder,
                                              const nlohmann::json& study) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    return absl::PermissionDeniedError(
        absl::StrFormat("%s: cannot be made: %s", folder.string(), error.message()));
  }
  const std::filesystem::path study_path = folder / "study.json";
  if (std::filesystem::exists(study_path, error)) {
    if (absl::Status status = CheckStudy(study_path, study); !status.ok()) return status;
  } else {
    std::ofstream(study_path) << study.dump(2) << "\n";
  }

  RecordStore store;
  store.path_ = folder / "lights.jsonl";
  std::ifstream kept(store.path_);
  for (std::string text; std::getline(kept, text);) {
    if (std::optional<Line> line = LineOf(text)) {
      Line& slot = store.lines_[{line->placement, line->index, line->method}];
      slot = *std::move(line);
    }
  }
  kept.close();
  // Written anew, so that a broken last line does not spoil the next one.
  store.file_.open(store.path_, std::ios::trunc);
  for (const auto& [key, line] : store.lines_) store.file_ << JsonOf(line).dump() << "\n";
  store.file_.flush();
  if (!store.file_) {
    return absl::PermissionDeniedError(absl::StrFormat("%s: cannot be written", store.path_.string()));
  }
  return store;
}

const RecordStore::Line* RecordStore::Find(LightPlacement placement, int index,
                                           const std::string& method) const {
  const auto found = lines_.find({placement, index, method});
  return found == lines_.end() ? nullptr : &found->second;
}

absl::Status RecordStore::Append(const Line& line) {
  file_ << JsonOf(line).dump() << "\n";
  file_.flush();
  if (!file_) return absl::DataLossError(absl::StrFormat("%s: cannot be written", path_.string()));
  lines_[{line.placement, line.index, line.method}] = line;
  return absl::OkStatus();
}

}  // namespace shadowfit
