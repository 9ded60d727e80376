uniform vec3 ws_towards_sun;  // Unit; zero where the scene has no directional light.
uniform vec3 sun_color;

// Light of the sky from a direction: darker and bluer above, warm around a low sun.
vec3 SkyRadiance(vec3 ws_direction) {
  float height = max(ws_direction.z, 0.0);
  vec3 sky = mix(vec3(0.50, 0.56, 0.64), vec3(0.12, 0.24, 0.50), 1.0 - exp(-3.5 * height));
  float glow = max(dot(ws_direction, ws_towards_sun), 0.0);
  sky += sun_color * (0.04 * pow(glow, 8.0) + 0.25 * pow(glow, 256.0));
  return sky * smoothstep(-0.25, 0.05, ws_direction.z) + vec3(0.11, 0.105, 0.09) * smoothstep(0.05, -0.25, ws_direction.z);
}

// Radiance to display values: a filmic curve (Hable's form, normalised at white 5.5), then the sRGB transfer function.
vec3 DisplayColor(vec3 radiance) {
  const float white = 5.5;
  vec4 x = vec4(1.8 * radiance, white);
  vec4 y = (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.50) + 0.06) - 0.004 / 0.06;
  vec3 c = clamp(y.rgb / y.a, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(vec3(0.0031308), c));
}
