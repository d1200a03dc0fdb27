#version 330 core
// Colours camera pixels that cannot be corrected, by the reason.
//
// Inputs: `reach`, output of reach.frag; `colours`, linear light: can be corrected, unlit, below mid grey, below white.
// Output: linear light, `white` times the colour.
// Pass: player/passes/shown_maps.py.
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
