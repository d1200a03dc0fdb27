#version 430 core
// Multiplies a picture by a sparse matrix, LANES invocations per output pixel (thesis 5.2); row_map.frag does the same
// with fragments.
//
// Inputs: `Rows` and `Entries` in the layout of player/maps/sliced_map.py: the rows of a workgroup have about equal length,
//   and their entries are interleaved; `source`, the picture. One index serves the three channels.
// Defines: GROUP, LANES; the defines of product.glsl.
// Output: `target`, output size, one value per row and channel.
// Pass: player/passes/product.py.
#include "lanes.glsl"
#include "product.glsl"

layout(std430, binding = 0) readonly buffer Rows { uvec4 rows[]; };
layout(std430, binding = 1) readonly buffer Entries { uvec4 entries[]; };
uniform sampler2D source;

vec3 product(uvec4 row) {
    vec3 sum = vec3(0.0);
    uint entry = row.w + lane();
    for (uint k = lane(); k < row.z; k += uint(LANES), entry += uint(GROUP)) {
        uvec4 bits = entries[entry];
        vec3 weights = uintBitsToFloat(bits.xyz);
        ivec2 at = unpacked(bits.w);
        sum += weights * texelFetch(source, at, 0).rgb;
    }
    return sum;
}

void main() {
    uvec4 row = rows[gl_GlobalInvocationID.x / uint(LANES)];
    vec3 sum = over_lanes(product(row));
    if (lane() != 0u || row.x == NO_PIXEL) {
        return;
    }
    ivec2 at = unpacked(row.x);
    imageStore(target, at, vec4(combined(sum, at, vec3(1.0)), 1.0));
}
