const int kMaxLights = 32;

// Light.test.x
const int kWithoutDepthErrors = 0;
const int kConstantBias = 1;
const int kSlopeScaledBias = 2;
const int kReceiverPlaneBias = 3;

struct Light {
  mat4 clip_from_world;   // To the clip space of the light's shadow map.
  vec4 ws_position;       // w = 1: position. w = 0: the direction towards a directional light.
  vec4 ws_axis;           // Axis of a spot, w = cosine of its outer half angle; w = -2 for other lights.
  vec4 power;             // RGB: irradiance (directional) or intensity (others).
  vec4 map_size;          // Width and height in texels.
  vec4 test;              // Kind (above), filter radius, and 1 for a tent filter.
  vec4 bias;              // In window depth: constant, slope, clamp.
};

layout(std140) uniform Lights {
  Light lights[kMaxLights];
  int light_count;
};

// From the point towards the light, not normalised.
vec3 TowardsLight(int i, vec3 ws_point) {
  return lights[i].ws_position.xyz - lights[i].ws_position.w * ws_point;
}

bool Illuminates(int i, vec3 ws_towards_light) {
  float cos_outer = lights[i].ws_axis.w;
  return cos_outer < -1.0 || dot(-ws_towards_light, lights[i].ws_axis.xyz) >= cos_outer * length(ws_towards_light);
}

// The side of the visible triangle that the viewer sees, as a unit normal. Derivatives of an interpolated position lie in
// the triangle's plane.
vec3 GeometricNormal(vec3 ws_point_dx, vec3 ws_point_dy) {
  // Screen x runs to the right and y upwards, so this product points at the viewer.
  return normalize(cross(ws_point_dx, ws_point_dy));
}
