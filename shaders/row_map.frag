#version 330 core
// Multiplies a picture by a sparse matrix, one output pixel per fragment (thesis 5.2).
//
// Inputs: `lookup`, output size, (x, y, length) of the row's first entry; `entries`, (w_R, w_G, w_B, index) with
//   index = x + y·SOURCE_WIDTH; `source`, the picture.
// Defines: SOURCE_WIDTH, compiled in because the division by a uniform took most of the time on llvmpipe; WIDE_INDEX
//   reads the index from a texture of its own; TILED draws only rows whose entries lie in the `lines` lines from
//   `first_line` on, which this tile of the entries texture holds; the defines of product.glsl.
// Output: one value per row and channel, output size.
// Pass: player/passes/product.py.
uniform usampler2D lookup;
uniform sampler2D entries;
uniform sampler2D source;
#ifdef WIDE_INDEX
uniform usampler2D wide_index;
#endif
#ifdef TILED
uniform int first_line;
uniform int lines;
#endif

out vec4 result;

#include "product.glsl"

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    uvec3 row = texelFetch(lookup, at, 0).rgb;
    ivec2 texel = ivec2(row.xy);
#ifdef TILED
    texel.y -= first_line;
    if (row.z > 0u && (texel.y < 0 || texel.y >= lines)) {
        discard;  // the row is in another tile; rows without entries are in every tile
    }
#endif
    int end = texel.x + int(row.z);
    vec3 sum = vec3(0.0);
    for (; texel.x < end; ++texel.x) {
        vec4 entry = texelFetch(entries, texel, 0);
#ifdef WIDE_INDEX
        int index = int(texelFetch(wide_index, texel, 0).r);
#else
        int index = int(entry.a);
#endif
        sum += entry.rgb * texelFetch(source, ivec2(index % SOURCE_WIDTH, index / SOURCE_WIDTH), 0).rgb;
    }
    result = vec4(combined(sum, at, vec3(1.0)), 1.0);
}
