// The final picture: diffuse surfaces under the lights, with their shadow maps. Drawn over the depth of the same surfaces,
// which has the holes of cutouts cut already.
in vec3 ws_point;
in vec3 ws_shading_normal;
in vec2 uv;

uniform vec3 ws_eye;
uniform bool is_cutout;
uniform vec3 diffuse;
uniform bool has_color_texture;
uniform sampler2D color_texture;

out vec4 color;

void main() {
  vec3 ws_point_dx = dFdx(ws_point);
  vec3 ws_point_dy = dFdy(ws_point);
  vec3 albedo = has_color_texture ? texture(color_texture, uv).rgb : diffuse;

  vec3 ws_normal = GeometricNormal(ws_point_dx, ws_point_dy);
  // Shading normals follow the side that is seen; leaf cards get the plane's own, which their outline contradicts least.
  vec3 n = ws_shading_normal;
  bool has_normal = dot(n, n) > 0.0 && !is_cutout;
  n = has_normal ? normalize(n) : ws_normal;
  if (dot(n, ws_normal) < 0.0) n = -n;

  // Leaves scatter light through: part of what the light brings is spread over all directions.
  float spread = is_cutout ? 0.45 : 0.0;
  vec3 irradiance = vec3(0.0);
  for (int i = 0; i < light_count; ++i) {
    vec3 ws_towards_light = TowardsLight(i, ws_point);
    bool lit = dot(ws_normal, ws_towards_light) > 0.0;
    if ((!lit && spread == 0.0) || !Illuminates(i, ws_towards_light)) continue;
    float shadow = lit ? ShadowShare(i, ws_point, ws_point_dx, ws_point_dy, ws_normal) : 0.0;
    if (shadow >= 1.0) continue;
    float squared_distance = dot(ws_towards_light, ws_towards_light);
    vec3 l = ws_towards_light * inversesqrt(squared_distance);
    float cosine = mix(max(dot(n, l), 0.0), 0.5, spread);
    float falloff = lights[i].ws_position.w == 0.0 ? 1.0 : 1.0 / max(squared_distance, 0.01);
    float cos_outer = lights[i].ws_axis.w;
    if (cos_outer >= -1.0) falloff *= smoothstep(cos_outer, mix(cos_outer, 1.0, 0.35), dot(-l, lights[i].ws_axis.xyz));
    irradiance += lights[i].power.rgb * (cosine * falloff * (1.0 - shadow));
  }
  // Ambient light: the sky above, and what the ground sends back from below.
  float upwards = 0.5 + 0.5 * n.z;
  vec3 ambient = mix(vec3(0.10, 0.09, 0.075), vec3(0.24, 0.29, 0.38), upwards);
  vec3 radiance = albedo * (irradiance + ambient);

  // A little haze ties the far end of the scene to the sky.
  vec3 view = ws_point - ws_eye;
  float haze = 1.0 - exp(-length(view) * 0.0022);
  color = vec4(DisplayColor(mix(radiance, SkyRadiance(normalize(vec3(view.xy, abs(view.z) + 1e-6))), haze)), 1.0);
}
