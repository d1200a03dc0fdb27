// Combines a row's sum with a base: ADD_TO_BASE / SUBTRACT_FROM_BASE give base ± the sum; WEIGHED_RESIDUAL multiplies the
// difference by `weight`, as source of the transpose; CLAMP limits the sum to 0..1.
#if defined(ADD_TO_BASE) || defined(SUBTRACT_FROM_BASE) || defined(WEIGHED_RESIDUAL)
uniform sampler2D base;
#endif

vec3 combined(vec3 sum, ivec2 at, vec3 weight) {
#if defined(ADD_TO_BASE)
    return texelFetch(base, at, 0).rgb + sum;
#elif defined(SUBTRACT_FROM_BASE)
    return texelFetch(base, at, 0).rgb - sum;
#elif defined(WEIGHED_RESIDUAL)
    return weight * (texelFetch(base, at, 0).rgb - sum);
#elif defined(CLAMP)
    return clamp(sum, 0.0, 1.0);
#else
    return sum;
#endif
}
