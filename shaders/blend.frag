#version 330 core
// Mixes two pictures in linear light.
//
// Inputs: `now`, `before`, of one size.
// Output: (1 − weight) now + weight gain before.
// Pass: player/passes/combine.py.
uniform sampler2D now, before;
uniform float weight;
uniform float gain = 1.0;  // light of one unit of `before`, in units of `now`

out vec4 result;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    result = vec4((1.0 - weight) * texelFetch(now, at, 0).rgb + weight * gain * texelFetch(before, at, 0).rgb, 1.0);
}
