#version 330 core
// Multiplies the channels of every pixel by the pixel's own matrix, and adds a picture.
//
// Inputs: `light`, `base`; `row_red`, `row_green`, `row_blue`, the rows of each pixel's matrix; of one size.
// Output: matrix · light + base.
// Pass: player/passes/mixing.py.
uniform sampler2D light, base, row_red, row_green, row_blue;

out vec4 result;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 given = texelFetch(light, at, 0).rgb;
    vec3 mixed = vec3(dot(texelFetch(row_red, at, 0).rgb, given), dot(texelFetch(row_green, at, 0).rgb, given),
                      dot(texelFetch(row_blue, at, 0).rgb, given));
    result = vec4(mixed + texelFetch(base, at, 0).rgb, 1.0);
}
