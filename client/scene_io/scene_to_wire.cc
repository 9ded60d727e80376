#include "client/scene_io/scene_to_wire.h"

#include <bit>

namespace shadowfit {
namespace {

static_assert(std::endian::native == std::endian::little,
              "arrays are little-endian and are copied as they are");

template <typename T>
void SetBytes(const std::vector<T>& from, std::string* to) {
  to->assign(reinterpret_cast<const char*>(from.data()), from.size() * sizeof(T));
}

}  // namespace

v1::SceneData SceneToWire(const Scene& scene) {
  v1::SceneData data;
  for (const Material& material : scene.materials) {
    v1::Material& out = *data.add_materials();
    if (material.alpha_texture >= 0) out.set_alpha_texture(static_cast<uint32_t>(material.alpha_texture));
    out.set_alpha_cutoff(material.alpha_cutoff);
    if (material.transmittance != glm::vec3(0.0f)) {
      out.mutable_transmittance()->set_x(material.transmittance.x);
      out.mutable_transmittance()->set_y(material.transmittance.y);
      out.mutable_transmittance()->set_z(material.transmittance.z);
    }
  }
  for (const AlphaTexture& texture : scene.alpha_textures) {
    v1::AlphaTexture& out = *data.add_alpha_textures();
    out.set_width(static_cast<uint32_t>(texture.width));
    out.set_height(static_cast<uint32_t>(texture.height));
    SetBytes(texture.alpha, out.mutable_alpha());
  }
  for (const Mesh& mesh : scene.meshes) {
    v1::Mesh& out = *data.add_meshes();
    out.set_vertex_count(static_cast<uint32_t>(mesh.positions.size()));
    out.set_triangle_count(static_cast<uint32_t>(mesh.triangles.size()));
    out.set_material(static_cast<uint32_t>(mesh.material));
    SetBytes(mesh.positions, out.mutable_positions());
    SetBytes(mesh.triangles, out.mutable_triangles());
    // Cutouts alone look at them.
    const bool cutout = scene.materials[static_cast<size_t>(mesh.material)].alpha_texture >= 0;
    if (cutout) SetBytes(mesh.uvs, out.mutable_texture_coordinates());
  }
  for (const Instance& instance : scene.instances) {
    v1::Instance& out = *data.add_instances();
    out.set_mesh(static_cast<uint32_t>(instance.mesh));
    if (instance.world_from_object == glm::mat4x3(1.0f)) continue;
    for (int i = 0; i < 12; ++i) out.add_world_from_object(instance.world_from_object[i / 3][i % 3]);
  }
  return data;
}

}  // namespace shadowfit
