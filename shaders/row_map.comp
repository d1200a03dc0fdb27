#version 430 core
// Multiplies a picture by a sparse matrix, LANES invocations per output pixel (thesis 5.2); row_map.frag does so in fragments.
//
// Inputs: `Rows` and `Entries` in the layout of player/maps/sliced_map.py: the rows of a workgroup have about equal length,
//   and their entries are interleaved; `source`, the picture. One index serves the three channels.
// Defines: GROUP, LANES; ADD_TO_BASE / SUBTRACT_FROM_BASE give base ± the product; CLAMP limits the result to 0..1.
// Output: `target`, output size, one value per row and channel.
// Pass: player/passes/product.py.
layout(local_size_x = GROUP) in;

layout(std430, binding = 0) readonly buffer Rows { uvec4 rows[]; };
layout(std430, binding = 1) readonly buffer Entries { uvec4 entries[]; };
layout(rgba32f, binding = 0) writeonly uniform image2D target;
uniform sampler2D source;
#if defined(ADD_TO_BASE) || defined(SUBTRACT_FROM_BASE)
uniform sampler2D base;
#endif
#if LANES > 1
shared vec3 sums[GROUP];
#endif

const uint NO_PIXEL = 0xFFFFFFFFu;

ivec2 unpacked(uint xy) { return ivec2(xy & 0xFFFFu, xy >> 16); }

vec3 product(uvec4 row, uint lane) {
    vec3 sum = vec3(0.0);
    uint entry = row.w + lane;
    for (uint k = lane; k < row.z; k += uint(LANES), entry += uint(GROUP)) {
        uvec4 bits = entries[entry];
        vec3 weights = uintBitsToFloat(bits.xyz);
        ivec2 at = unpacked(bits.w);
        sum += weights * texelFetch(source, at, 0).rgb;
    }
    return sum;
}

void main() {
    uint lane = gl_LocalInvocationID.x % uint(LANES);
    uvec4 row = rows[gl_GlobalInvocationID.x / uint(LANES)];
    vec3 sum = product(row, lane);
#if LANES > 1
    sums[gl_LocalInvocationID.x] = sum;
    for (uint half_way = uint(LANES) / 2u; half_way > 0u; half_way /= 2u) {
        barrier();
        if (lane < half_way) {
            sum += sums[gl_LocalInvocationID.x + half_way];
            sums[gl_LocalInvocationID.x] = sum;
        }
    }
#endif
    if (lane != 0u || row.x == NO_PIXEL) {
        return;
    }
    ivec2 at = unpacked(row.x);
#if defined(ADD_TO_BASE)
    sum = texelFetch(base, at, 0).rgb + sum;
#elif defined(SUBTRACT_FROM_BASE)
    sum = texelFetch(base, at, 0).rgb - sum;
#endif
#ifdef CLAMP
    sum = clamp(sum, 0.0, 1.0);
#endif
    imageStore(target, at, vec4(sum, 1.0));
}
