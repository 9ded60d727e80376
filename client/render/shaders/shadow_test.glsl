uniform sampler2DArray shadow_maps;  // Layer i: window depth as seen by light i.
uniform float ws_bias;               // Lift off the surface; some float roundings of the scene's coordinates.
uniform float ndc_bias;              // Rounding of the rasteriser's depth.

// Whether light i's map shadows the point. The map says where its texel's centre is blocked, so the receiver is compared
// there as well: not with its own depth but with the depth that its tangent plane has on the ray through the texel's
// centre. On a plane, NDC depth is an affine function of NDC x and y, so the extrapolation is exact, and what remains is
// the map's aliasing alone.
bool InShadow(int i, vec3 ws_point, vec3 ws_point_dx, vec3 ws_point_dy, vec3 ws_normal) {
  mat4 clip_from_world = lights[i].clip_from_world;
  vec4 clip = clip_from_world * vec4(ws_point + ws_bias * ws_normal, 1.0);
  if (clip.w <= 0.0) return false;
  vec3 ndc = clip.xyz / clip.w;
  if (any(greaterThan(abs(ndc.xy), vec2(1.0)))) return false;

  vec2 size = lights[i].map_size.xy;
  vec2 texel = floor(min((0.5 * ndc.xy + 0.5) * size, size - 0.5));
  vec2 to_centre = (texel + 0.5) / size * 2.0 - 1.0 - ndc.xy;

  vec4 clip_dx = clip_from_world * vec4(ws_point_dx, 0.0);
  vec4 clip_dy = clip_from_world * vec4(ws_point_dy, 0.0);
  vec3 ndc_dx = clip_dx.xyz - ndc * clip_dx.w;  // Both times w, which cancels below.
  vec3 ndc_dy = clip_dy.xyz - ndc * clip_dy.w;
  float determinant = ndc_dx.x * ndc_dy.y - ndc_dx.y * ndc_dy.x;
  // Edge-on to the light the plane has no depth at the centre; such a surface receives no light either.
  if (determinant == 0.0) return false;
  vec2 depth_slope = vec2(ndc_dx.z * ndc_dy.y - ndc_dy.z * ndc_dx.y, ndc_dy.z * ndc_dx.x - ndc_dx.z * ndc_dy.x) / determinant;
  // A ray that runs alongside the plane never meets it: beyond the far plane is infinitely far, and any caster nearer.
  float receiver = min(ndc.z + dot(depth_slope, to_centre), 1.0);

  float caster = texelFetch(shadow_maps, ivec3(texel, i), 0).r;
  return caster < 0.5 * (receiver - ndc_bias) + 0.5;
}
