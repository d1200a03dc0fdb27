#version 330 core
// Sums each block of side × side pixels. A few such passes in a row sum a picture.
//
// Inputs: `source`.
// Output: one value per block and channel; blocks at the right and lower edge may be smaller.
// Pass: player/passes/certificate.py.
uniform sampler2D source;
uniform int side;

out vec4 sum;

void main() {
    ivec2 first = ivec2(gl_FragCoord.xy) * side;
    ivec2 end = min(first + side, textureSize(source, 0));
    vec4 total = vec4(0.0);
    for (int row = first.y; row < end.y; ++row) {
        for (int column = first.x; column < end.x; ++column) {
            total += texelFetch(source, ivec2(column, row), 0);
        }
    }
    sum = total;
}
