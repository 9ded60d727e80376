// What the optimizer reads: beside depth, one bit a light that says whether the light's map leaves the pixel in shadow.
in vec3 ws_point;

out uint shadow_bits;

void main() {
  vec3 ws_point_dx = dFdx(ws_point);
  vec3 ws_point_dy = dFdy(ws_point);
  DiscardHoles();
  vec3 ws_normal = GeometricNormal(ws_point_dx, ws_point_dy);
  uint bits = 0u;
  for (int i = 0; i < light_count; ++i) {
    vec3 ws_towards_light = TowardsLight(i, ws_point);
    if (dot(ws_normal, ws_towards_light) <= 0.0 || !Illuminates(i, ws_towards_light)) continue;
    if (ShadowShare(i, ws_point, ws_point_dx, ws_point_dy, ws_normal) > 0.5) bits |= 1u << i;
  }
  shadow_bits = bits;
}
