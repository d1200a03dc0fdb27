#version 330 core
// Which camera pixels cannot be corrected, and why, as a colour.
//
// Inputs: `reach`, as reach.frag leaves it; `colours`, linear light: can be corrected, unlit, below mid grey, below white.
// Output: linear light, `white` times the colour.
// CPU twin: impossible in player/pipeline/reference.py.
uniform sampler2D reach, colours;
uniform float white, mid_grey;   // radiance of both
uniform float slack;

out vec4 light;

void main() {
    vec4 most = texelFetch(reach, ivec2(gl_FragCoord.xy), 0);
    float least = min(min(most.r, most.g), most.b) * (1.0 + slack);
    int kind = most.a == 0.0 ? 1 : least < mid_grey ? 2 : least < white ? 3 : 0;
    light = vec4(white * texelFetch(colours, ivec2(kind, 0), 0).rgb, 1.0);
}
