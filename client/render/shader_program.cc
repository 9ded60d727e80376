#include "client/render/shader_program.h"

#include <string>
#include <vector>

#include "absl/strings/str_format.h"

namespace shadowfit {
namespace {

absl::Status Compile(GLuint shader, std::initializer_list<const char*> parts) {
  std::vector<const char*> sources = {"#version 330 core\n"};
  sources.insert(sources.end(), parts);
  glShaderSource(shader, static_cast<GLsizei>(sources.size()), sources.data(), nullptr);
  glCompileShader(shader);
  GLint compiled = GL_FALSE;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
  if (compiled == GL_TRUE) return absl::OkStatus();
  std::string log(4096, '\0');
  GLsizei length = 0;
  glGetShaderInfoLog(shader, static_cast<GLsizei>(log.size()), &length, log.data());
  log.resize(static_cast<size_t>(length));
  return absl::InternalError(absl::StrFormat("OpenGL: a shader does not compile: %s", log));
}

}  // namespace

absl::StatusOr<ShaderProgram> ShaderProgram::Create(std::initializer_list<const char*> vertex_parts,
                                                    std::initializer_list<const char*> fragment_parts) {
  ShaderProgram program(glCreateProgram());
  const std::pair<GLenum, std::initializer_list<const char*>> stages[] = {
      {GL_VERTEX_SHADER, vertex_parts}, {GL_FRAGMENT_SHADER, fragment_parts}};
  for (const auto& [kind, parts] : stages) {
    const GLuint shader = glCreateShader(kind);
    const absl::Status status = Compile(shader, parts);
    glAttachShader(program.name_, shader);
    glDeleteShader(shader);  // Goes with the program.
    if (!status.ok()) return status;
  }
  glLinkProgram(program.name_);
  GLint linked = GL_FALSE;
  glGetProgramiv(program.name_, GL_LINK_STATUS, &linked);
  if (linked != GL_TRUE) {
    std::string log(4096, '\0');
    GLsizei length = 0;
    glGetProgramInfoLog(program.name_, static_cast<GLsizei>(log.size()), &length, log.data());
    log.resize(static_cast<size_t>(length));
    return absl::InternalError(absl::StrFormat("OpenGL: a program does not link: %s", log));
  }
  return program;
}

void ShaderProgram::Set(const char* uniform, int value) const {
  glUniform1i(glGetUniformLocation(name_, uniform), value);
}
void ShaderProgram::Set(const char* uniform, float value) const {
  glUniform1f(glGetUniformLocation(name_, uniform), value);
}
void ShaderProgram::Set(const char* uniform, const glm::vec3& value) const {
  glUniform3fv(glGetUniformLocation(name_, uniform), 1, &value.x);
}
void ShaderProgram::Set(const char* uniform, const glm::mat4& value) const {
  glUniformMatrix4fv(glGetUniformLocation(name_, uniform), 1, GL_FALSE, &value[0].x);
}
void ShaderProgram::BindBlock(const char* block, GLuint binding) const {
  const GLuint index = glGetUniformBlockIndex(name_, block);
  if (index != GL_INVALID_INDEX) glUniformBlockBinding(name_, index, binding);
}

}  // namespace shadowfit
