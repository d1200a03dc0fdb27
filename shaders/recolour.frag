#version 330 core
// Multiplies the channels of all pixels by one matrix, for example from a camera's radiance to screen primaries.
//
// Inputs: `picture`, linear RGB.
// Output: matrix · picture.
// Pass: player/passes/mixing.py.
uniform sampler2D picture;
uniform mat3 matrix;

out vec4 result;

void main() {
    result = vec4(matrix * texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.0);
}
