#version 330 core
// The square of the camera's error where it counts.
//
// Inputs: `residual`, b − T p; `mask`, not 0 inside; of one size.
// Output: residual² inside the mask, 0 outside.
// CPU twin: squared_error in player/pipeline/reference.py.
uniform sampler2D residual;
uniform usampler2D mask;

out vec4 squared;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 error = texelFetch(residual, at, 0).rgb;
    squared = vec4(texelFetch(mask, at, 0).r != 0u ? error * error : vec3(0.0), 1.0);
}
