#pragma once

#include "core/scene/scene.h"
#include "shadowfit/v1/scene.pb.h"

namespace shadowfit {

/// What of a scene casts shadows, in wire form: without colours, names and shading normals.
v1::SceneData SceneToWire(const Scene& scene);

}  // namespace shadowfit
