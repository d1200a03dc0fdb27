// Output of a compute shader whose rows have LANES invocations each, in workgroups of GROUP (player/maps/sliced_map.py).
layout(local_size_x = GROUP) in;
layout(rgba32f, binding = 0) writeonly uniform image2D target;
#if LANES > 1
shared vec3 sums[GROUP];
#endif

const uint NO_PIXEL = 0xFFFFFFFFu;

uint lane() { return gl_LocalInvocationID.x % uint(LANES); }

ivec2 unpacked(uint xy) { return ivec2(xy & 0xFFFFu, xy >> 16); }

// Adds the sums of a row's invocations; lane 0 returns the result.
vec3 over_lanes(vec3 sum) {
#if LANES > 1
    uint own = gl_LocalInvocationID.x;
    sums[own] = sum;
    for (uint half_way = uint(LANES) / 2u; half_way > 0u; half_way /= 2u) {
        barrier();
        if (lane() < half_way) {
            sum += sums[own + half_way];
            sums[own] = sum;
        }
    }
#endif
    return sum;
}
