// Holes of cutouts. Every program that draws the scene calls DiscardHoles().
in vec2 uv;

uniform bool is_cutout;
uniform sampler2D alpha_texture;
uniform float alpha_cutoff;

// Nearest texel, repeated, by the same arithmetic as AlphaTexture::AlphaAt, so that every pass and the ray tracer see the
// same holes.
void DiscardHoles() {
  if (!is_cutout) return;
  ivec2 size = textureSize(alpha_texture, 0);
  ivec2 texel = min(ivec2((uv - floor(uv)) * vec2(size)), size - 1);
  if (texelFetch(alpha_texture, texel, 0).r < alpha_cutoff) discard;
}
