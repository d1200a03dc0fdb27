#version 330 core
// Multiplies a picture by a sparse matrix of 4-byte words, one output pixel per fragment; row_map.frag uses 16-byte entries.
//
// Inputs: `rows`, output size and one more line, the row's first word and, if COLOURED, its colour; `words`, WORDS_ACROSS
//   per line; `source`, the picture; `scale`, of the codes.
// Defines: SOURCE_WIDTH, WORDS_ACROSS; COLOURED; ADD_TO_BASE / SUBTRACT_FROM_BASE give base ± the product;
//   WEIGHED_RESIDUAL multiplies the difference by trust and colour, as source of the transpose; CLAMP limits to 0..1.
// Output: one value per row and channel, output size.
// Pass: player/passes/product.py.
uniform usampler2D rows, words;
uniform sampler2D source;
uniform float scale;
#if defined(ADD_TO_BASE) || defined(SUBTRACT_FROM_BASE) || defined(WEIGHED_RESIDUAL)
uniform sampler2D base;
#endif

out vec4 result;

uint word_at(uint k) { return texelFetch(words, ivec2(k % uint(WORDS_ACROSS), k / uint(WORDS_ACROSS)), 0).r; }

#include "small_words.glsl"

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy), next = at + ivec2(1, 0);
    if (next.x == textureSize(rows, 0).x) {
        next = ivec2(0, at.y + 1);
    }
    uvec2 row = texelFetch(rows, at, 0).rg;
    Run run = run_of(row.x, texelFetch(rows, next, 0).r, 1u);
    vec3 sum = scale * run.sum;
#ifdef COLOURED
    vec3 colour = colour_of(row.y);
    sum *= colour;
#endif
#if defined(ADD_TO_BASE)
    sum = texelFetch(base, at, 0).rgb + sum;
#elif defined(SUBTRACT_FROM_BASE)
    sum = texelFetch(base, at, 0).rgb - sum;
#elif defined(WEIGHED_RESIDUAL)
    sum = run.trust * colour * (texelFetch(base, at, 0).rgb - sum);
#elif defined(CLAMP)
    sum = clamp(sum, 0.0, 1.0);
#endif
    result = vec4(sum, 1.0);
}
