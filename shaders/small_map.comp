#version 430 core
// Multiplies a picture by a sparse matrix of 4-byte words, LANES invocations per output pixel. small_map.frag does so in
// fragments; row_map.comp uses entries of 16 bytes.
//
// Inputs: `Rows`, `Groups` and `Words` in the layout of player/maps/sliced_words.py; `source`, the picture; `scale`, of the
//   codes.
// Defines: GROUP, LANES, SOURCE_WIDTH; COLOURED; ADD_TO_BASE / SUBTRACT_FROM_BASE give base ± the product;
//   WEIGHED_RESIDUAL multiplies the difference by trust and colour, as source of the transpose; CLAMP limits to 0..1.
// Output: `target`, output size, one value per row and channel.
// Pass: player/passes/product.py.
layout(local_size_x = GROUP) in;

layout(std430, binding = 0) readonly buffer Rows { uint rows[]; };
layout(std430, binding = 1) readonly buffer Words { uint words[]; };
layout(std430, binding = 2) readonly buffer Groups { uvec2 groups[]; };
layout(rgba32f, binding = 0) writeonly uniform image2D target;
uniform sampler2D source;
uniform float scale;
#if defined(ADD_TO_BASE) || defined(SUBTRACT_FROM_BASE) || defined(WEIGHED_RESIDUAL)
uniform sampler2D base;
#endif
#if LANES > 1
shared vec3 sums[GROUP];
#endif

#ifdef COLOURED
const uint ROW = 2u;
#else
const uint ROW = 1u;
#endif
const uint NO_PIXEL = 0xFFFFFFFFu;

uint word_at(uint k) { return words[k]; }

#include "small_words.glsl"

void main() {
    uint own = gl_LocalInvocationID.x, lane = own % uint(LANES);
    uint row = gl_GlobalInvocationID.x / uint(LANES) * ROW;
    uvec2 group = groups[gl_WorkGroupID.x];
    Run run = run_of(group.x + own, group.x + group.y * uint(GROUP), uint(GROUP));
#if LANES > 1
    sums[own] = run.sum;
    for (uint half_way = uint(LANES) / 2u; half_way > 0u; half_way /= 2u) {
        barrier();
        if (lane < half_way) {
            run.sum += sums[own + half_way];
            sums[own] = run.sum;
        }
    }
#endif
    if (lane != 0u || rows[row] == NO_PIXEL) {
        return;
    }
    ivec2 at = ivec2(rows[row] & 0xFFFFu, rows[row] >> 16);
    vec3 sum = scale * run.sum;
#ifdef COLOURED
    vec3 colour = colour_of(rows[row + 1u]);
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
    imageStore(target, at, vec4(sum, 1.0));
}
