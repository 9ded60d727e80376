#pragma once

#include <glm/glm.hpp>
#include <initializer_list>
#include <utility>

#include "absl/status/statusor.h"
#include "client/render/gl.h"

namespace shadowfit {

/// A linked vertex and fragment shader. Must die while its context is current.
class ShaderProgram {
 public:
  /// Each shader is its parts one after the other, behind the version line. Internal with the compiler's log
  /// on failure.
  static absl::StatusOr<ShaderProgram> Create(std::initializer_list<const char*> vertex_parts,
                                              std::initializer_list<const char*> fragment_parts);
  ~ShaderProgram() {
    if (name_ != 0) glDeleteProgram(name_);
  }
  ShaderProgram(ShaderProgram&& other) noexcept : name_(std::exchange(other.name_, 0)) {}
  ShaderProgram& operator=(ShaderProgram&& other) noexcept {
    std::swap(name_, other.name_);
    return *this;
  }

  void Use() const { glUseProgram(name_); }

  // Setting a uniform that the compiler dropped does nothing. The program must be in use.
  void Set(const char* uniform, int value) const;
  void Set(const char* uniform, float value) const;
  void Set(const char* uniform, const glm::vec3& value) const;
  void Set(const char* uniform, const glm::mat4& value) const;

  /// Connects a uniform block to an indexed buffer binding.
  void BindBlock(const char* block, GLuint binding) const;

 private:
  explicit ShaderProgram(GLuint name) : name_(name) {}
  GLuint name_ = 0;
};

}  // namespace shadowfit
