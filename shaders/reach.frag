#version 330 core
// Computes the brightest grey that each primary lets a pixel show, and the mask of camera pixels that count.
//
// Inputs: `seen`, light under full drive; `ambient`, light without drive; `mask`, not 0 inside; of one size.
// Defines: MIXED: `seen` is without ambient light, and grey is mixed by each pixel's matrix, `row_red`, `row_green`,
//   `row_blue` (grey_reach in player/maps/mixing.py); `unlimited` is the grey where a primary is not needed.
// Output: the grey of each primary; alpha 1 inside the mask where every channel is lit, 0 elsewhere.
// Pass: player/passes/reach.py.
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
    reach = vec4(light, lit && texelFetch(mask, at, 0).r != 0u ? 1.0 : 0.0);
}
