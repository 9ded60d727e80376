// Depth only.
void main() { DiscardHoles(); }
