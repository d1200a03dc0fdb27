#version 430 core
// Multiplies a picture by a sparse matrix of 4-byte words, LANES invocations per output pixel. small_map.frag does so in
// fragments; row_map.comp uses entries of 16 bytes.
//
// Inputs: `Rows`, `Groups` and `Words` in the layout of player/maps/sliced_map.py; `source`, the picture; `scale`,
//   the scale of the codes.
// Defines: GROUP, LANES, SOURCE_WIDTH; COLOURED; the defines of product.glsl.
// Output: `target`, output size, one value per row and channel.
// Pass: player/passes/product.py.
#include "lanes.glsl"

layout(std430, binding = 0) readonly buffer Rows { uint rows[]; };
layout(std430, binding = 1) readonly buffer Words { uint words[]; };
layout(std430, binding = 2) readonly buffer Groups { uvec2 groups[]; };
uniform sampler2D source;

#ifdef COLOURED
const uint ROW = 2u;
#else
const uint ROW = 1u;
#endif

uint word_at(uint k) { return words[k]; }

#include "small_words.glsl"

void main() {
    uint own = gl_LocalInvocationID.x;
    uint row = gl_GlobalInvocationID.x / uint(LANES) * ROW;
    uvec2 group = groups[gl_WorkGroupID.x];
    Run run = run_of(group.x + own, group.x + group.y * uint(GROUP), uint(GROUP));
    run.sum = over_lanes(run.sum);
    if (lane() != 0u || rows[row] == NO_PIXEL) {
        return;
    }
    ivec2 at = unpacked(rows[row]);
    imageStore(target, at, vec4(value_of(run, rows[row + ROW - 1u], at), 1.0));
}
