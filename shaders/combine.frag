#version 330 core
// Adds a multiple of one picture to another.
//
// Inputs: `first`, `second`, of one size.
// Defines: CLAMP limits the result to 0..1.
// Output: first + factor · second.
// Pass: player/passes/combine.py.
uniform sampler2D first, second;
uniform float factor;

out vec4 result;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 sum = texelFetch(first, at, 0).rgb + factor * texelFetch(second, at, 0).rgb;
#ifdef CLAMP
    sum = clamp(sum, 0.0, 1.0);
#endif
    result = vec4(sum, 1.0);
}
