#version 330 core
// Sums clipping minus the allowed clipping, for 4 of 16 candidates in one tile of the camera's view (player/pipeline/content.py).
//
// Inputs: `picture`, u in shares of white; `near`, u − F u; `near_white`, 1 − F 1; `near_ambient`, e − F e; `ambient`, e;
//   `most`, near light of full drive, alpha 0 where a pixel does not count; `candidates`, 16 values; with SCALES `tone`,
//   whose second value is o.
// Defines: TILES, tiles per side; SCALES: candidates are shares of the greatest scale at the given offset. Without SCALES,
//   candidates are offsets at their greatest scales, and only values below 0 count.
// Output: TILES columns, 4 · TILES rows: the tiles, four times, for candidates 0..3, 4..7, 8..11 and 12..15.
// Pass: player/passes/adaptation.py.
uniform sampler2D picture, near, near_white, near_ambient, ambient, most, candidates;
#ifdef SCALES
uniform sampler2D tone;
#endif
uniform ivec2 tile, stride;      // pixels of a tile, and pixels between two samples
uniform float white, budget;

out vec4 sums;

vec4 four(int group) {
    vec4 value;
    for (int k = 0; k < 4; ++k) value[k] = texelFetch(candidates, ivec2(4 * group + k, 0), 0).r;
    return value;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    ivec2 first = ivec2(at.x, at.y % TILES) * tile;
    ivec2 end = min(first + tile, textureSize(picture, 0));
#ifdef SCALES
    vec4 o = vec4(texelFetch(tone, ivec2(0), 0).g), s = (1.0 - o) * four(at.y / TILES);
#else
    vec4 o = four(at.y / TILES), s = 1.0 - o;
#endif
    sums = vec4(0.0);
    for (int row = first.y; row < end.y; row += stride.y) {
        for (int column = first.x; column < end.x; column += stride.x) {
            ivec2 sampled = ivec2(column, row);
            vec4 highest = texelFetch(most, sampled, 0);
            if (highest.a == 0.0) continue;
            vec3 asked = white * texelFetch(picture, sampled, 0).rgb;
            vec3 allowed = budget * max(asked, texelFetch(ambient, sampled, 0).rgb);
            vec3 per_scale = white * texelFetch(near, sampled, 0).rgb;
            vec3 per_offset = white * texelFetch(near_white, sampled, 0).rgb;
            vec3 taken = texelFetch(near_ambient, sampled, 0).rgb;
            for (int k = 0; k < 3; ++k) {
                vec4 needed = s * per_scale[k] + o * per_offset[k] - taken[k];
                sums += max(-needed, 0.0) - allowed[k];
#ifdef SCALES
                sums += max(needed - highest[k], 0.0);
#endif
            }
        }
    }
}
