// World-space geometry through one matrix: a camera's or a light's.
layout(location = 0) in vec3 in_ws_position;
layout(location = 1) in vec3 in_ws_normal;
layout(location = 2) in vec2 in_uv;

invariant gl_Position;  // A later pass meets the depth that an earlier one left.

uniform mat4 clip_from_world;

out vec3 ws_point;
out vec3 ws_shading_normal;
out vec2 uv;

void main() {
  ws_point = in_ws_position;
  ws_shading_normal = in_ws_normal;
  uv = in_uv;
  gl_Position = clip_from_world * vec4(in_ws_position, 1.0);
}
