#pragma once

#include "server/scene_store.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {

inline void EncodeSceneInfo(const SceneStore::Entry& entry, v1::SceneInfo* info) {
  info->set_digest(entry.scene->digest);
  info->set_triangles(entry.scene->scene.TriangleCount());
  info->set_instances(static_cast<uint32_t>(entry.scene->scene.InstanceCount()));
  info->set_bytes(entry.scene->room.bytes());
  info->set_uses(static_cast<uint32_t>(entry.uses));
}

}  // namespace shadowfit
