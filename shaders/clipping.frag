#version 330 core
// Colours pixels whose target is beyond what can be shown. The strength shows by how much.
//
// Inputs, all of one size: `view`, linear light; `asked`, the target. Targets from 0 to 1 can be shown; with MOST, targets
//   from 0 to `most`, whose alpha is 0 where a pixel does not count.
// Output: linear light.
// Pass: player/passes/shown_maps.py.
uniform sampler2D view, asked;
#ifdef MOST
uniform sampler2D most;
#endif
uniform float white;             // light of the colours
uniform float faint, full;       // amounts of half and of full strength, in shares of `white`
uniform vec3 above, below;

out vec4 light;

float greatest(vec3 v) { return max(max(v.r, v.g), v.b); }

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 wanted = texelFetch(asked, at, 0).rgb, shown = texelFetch(view, at, 0).rgb;
#ifdef MOST
    vec4 highest = texelFetch(most, at, 0);
#else
    vec4 highest = vec4(1.0);
#endif
    float over = greatest(wanted - highest.rgb) / white, under = greatest(-wanted) / white;
    float amount = highest.a > 0.0 ? max(max(over, under), 0.0) : 0.0;
    float weight = 0.5 * min(amount / faint, 1.0) + 0.5 * min(amount / full, 1.0);
    light = vec4(mix(shown, white * (over >= under ? above : below), weight), 1.0);
}
