#version 330 core
// Multiplies a picture by a sparse matrix of 4-byte words, one output pixel per fragment; row_map.frag uses 16-byte entries.
//
// Inputs: `rows`, output size and one more line, the row's first word and, if COLOURED, its colour; `words`,
//   WORDS_ACROSS per line; `source`, the picture; `scale`, the scale of the codes.
// Defines: SOURCE_WIDTH, WORDS_ACROSS; COLOURED; the defines of product.glsl.
// Output: one value per row and channel, output size.
// Pass: player/passes/product.py.
uniform usampler2D rows, words;
uniform sampler2D source;

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
    result = vec4(value_of(run, row.y, at), 1.0);
}
