#version 330 core
// What full drive gives, and which camera pixels count.
//
// Inputs: `seen`, what full drive gives; `ambient`, what no drive gives; `mask`, not 0 inside; of one size.
// Output: `seen`; alpha 1 inside the mask where every channel is lit, 0 elsewhere.
// CPU twin: reach_of in player/pipeline/reference.py.
uniform sampler2D seen, ambient;
uniform usampler2D mask;

out vec4 reach;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 light = texelFetch(seen, at, 0).rgb;
    bool lit = texelFetch(mask, at, 0).r != 0u && all(greaterThan(light, texelFetch(ambient, at, 0).rgb));
    reach = vec4(light, lit ? 1.0 : 0.0);
}
