in vec3 ws_view;

out vec4 color;

void main() { color = vec4(DisplayColor(SkyRadiance(normalize(ws_view))), 1.0); }
