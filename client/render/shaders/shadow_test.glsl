uniform sampler2DArray shadow_maps;  // Layer i: window depth as seen by light i.
uniform float ws_bias;               // Lift off the surface; some float roundings of the scene's coordinates.
uniform float ndc_bias;              // Rounding of the rasteriser's depth.

// NDC depth per NDC x and y along the plane through the point; false where the light sees the plane edge-on, which
// receives no light then either.
bool DepthSlope(mat4 clip_from_world, vec3 ndc, vec3 ws_point_dx, vec3 ws_point_dy, out vec2 slope) {
  vec4 clip_dx = clip_from_world * vec4(ws_point_dx, 0.0);
  vec4 clip_dy = clip_from_world * vec4(ws_point_dy, 0.0);
  vec3 ndc_dx = clip_dx.xyz - ndc * clip_dx.w;  // Both times w, which cancels below.
  vec3 ndc_dy = clip_dy.xyz - ndc * clip_dy.w;
  float determinant = ndc_dx.x * ndc_dy.y - ndc_dx.y * ndc_dy.x;
  slope = vec2(ndc_dx.z * ndc_dy.y - ndc_dy.z * ndc_dx.y, ndc_dy.z * ndc_dx.x - ndc_dx.z * ndc_dy.x) / determinant;
  return determinant != 0.0;
}

// The standard test: the share of the taps, by weight, that shadow the receiver.
float StandardShadow(int i, vec3 ndc, vec2 ndc_slope) {
  ivec2 size = ivec2(lights[i].map_size.xy);
  int kind = int(lights[i].test.x);
  int radius = int(lights[i].test.y);
  vec2 place = (0.5 * ndc.xy + 0.5) * vec2(size);
  ivec2 centre = min(ivec2(place), size - 1);
  // Window depth, per texel.
  float depth = 0.5 * ndc.z + 0.5;
  vec2 slope = ndc_slope / vec2(size);
  vec3 terms = lights[i].bias.xyz;
  float bias = terms.x;
  if (kind == kSlopeScaledBias) bias = min(bias + terms.y * (abs(slope.x) + abs(slope.y)), terms.z);
  bool tent = lights[i].test.z > 0.5;
  float shadowed = 0.0;
  for (int y = max(0, centre.y - radius); y <= min(size.y - 1, centre.y + radius); ++y) {
    for (int x = max(0, centre.x - radius); x <= min(size.x - 1, centre.x + radius); ++x) {
      float compared = kind == kReceiverPlaneBias ? depth + dot(slope, vec2(x, y) + 0.5 - place) : depth;
      // Compared as the map can hold it.
      if (texelFetch(shadow_maps, ivec3(x, y, i), 0).r < min(1.0, compared - bias)) {
        vec2 weight = vec2(radius + 1) - abs(vec2(ivec2(x, y) - centre));
        shadowed += tent ? weight.x * weight.y : 1.0;
      }
    }
  }
  float side = float(tent ? (radius + 1) * (radius + 1) : 2 * radius + 1);  // Sum of weights along an axis.
  return shadowed / (side * side);
}

// How much of light i its map takes from the point, 0 to 1.
//
// Without depth errors: the map says where its texel's centre is blocked, so the receiver is compared there as well: not
// with its own depth but with the depth that its tangent plane has on the ray through the texel's centre. On a plane, NDC
// depth is an affine function of NDC x and y, so the extrapolation is exact, and what remains is the map's aliasing alone.
float ShadowShare(int i, vec3 ws_point, vec3 ws_point_dx, vec3 ws_point_dy, vec3 ws_normal) {
  mat4 clip_from_world = lights[i].clip_from_world;
  bool standard = int(lights[i].test.x) != kWithoutDepthErrors;
  vec4 clip = clip_from_world * vec4(standard ? ws_point : ws_point + ws_bias * ws_normal, 1.0);
  if (clip.w <= 0.0) return 0.0;
  vec3 ndc = clip.xyz / clip.w;
  if (any(greaterThan(abs(ndc.xy), vec2(1.0)))) return 0.0;
  vec2 depth_slope;
  if (!DepthSlope(clip_from_world, ndc, ws_point_dx, ws_point_dy, depth_slope)) return 0.0;
  if (standard) return StandardShadow(i, ndc, depth_slope);

  vec2 size = lights[i].map_size.xy;
  vec2 texel = floor(min((0.5 * ndc.xy + 0.5) * size, size - 0.5));
  vec2 to_centre = (texel + 0.5) / size * 2.0 - 1.0 - ndc.xy;
  // A ray that runs alongside the plane never meets it: beyond the far plane is infinitely far, and any caster nearer.
  float receiver = min(ndc.z + dot(depth_slope, to_centre), 1.0);

  float caster = texelFetch(shadow_maps, ivec3(texel, i), 0).r;
  return caster < 0.5 * (receiver - ndc_bias) + 0.5 ? 1.0 : 0.0;
}
