// One triangle over the whole screen, at the far plane.
uniform mat4 world_from_clip;

out vec3 ws_view;

void main() {
  vec2 ndc = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  vec4 ws_far = world_from_clip * vec4(ndc, 1.0, 1.0);
  vec4 ws_near = world_from_clip * vec4(ndc, -1.0, 1.0);
  ws_view = ws_far.xyz / ws_far.w - ws_near.xyz / ws_near.w;
  gl_Position = vec4(ndc, 1.0, 1.0);
}
