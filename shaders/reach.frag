#version 330 core
// The brightest grey that each primary lets a pixel show, and which camera pixels count.
//
// Inputs: `seen`, what full drive gives; `ambient`, what no drive gives; `mask`, not 0 inside; of one size.
// Defines: MIXED: `seen` is without ambient light, and grey asks for it through each pixel's matrix, `row_red`,
//   `row_green`, `row_blue` (grey_reach in player/maps/mixing.py); `unlimited` is the grey of what asks for nothing.
//   ABOVE: what full drive adds, instead.
// Output: that grey; alpha 1 inside the mask where every channel is lit, 0 elsewhere.
// CPU twin: reach_of in player/pipeline/reference.py.
uniform sampler2D seen, ambient;
uniform usampler2D mask;
#ifdef MIXED
uniform sampler2D row_red, row_green, row_blue;
uniform float unlimited;
#endif

out vec4 reach;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 light = texelFetch(seen, at, 0).rgb, dark = texelFetch(ambient, at, 0).rgb;
#ifdef MIXED
    vec3 rows[3] = vec3[3](texelFetch(row_red, at, 0).rgb, texelFetch(row_green, at, 0).rgb,
                           texelFetch(row_blue, at, 0).rgb);
    bool lit = all(greaterThan(light, vec3(0.0)));
    for (int i = 0; i < 3; i++) {
        float share = dot(rows[i], vec3(1.0)), limit = light[i] + dot(rows[i], dark);
        light[i] = share > 0.0 ? min(limit, unlimited * share) / share : unlimited;
    }
#else
    bool lit = all(greaterThan(light, dark));
#endif
#ifdef ABOVE
    light -= dark;
#endif
    reach = vec4(light, lit && texelFetch(mask, at, 0).r != 0u ? 1.0 : 0.0);
}
