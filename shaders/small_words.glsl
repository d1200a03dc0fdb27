// Runs of 4-byte words (player/maps/small_map.py): Σ code ∘ source, and the row's trust if the run holds it.
//
// The including file must define `source`, the picture, `uint word_at(uint k)`, and SOURCE_WIDTH. `scale` is the scale
// of the codes.
#include "product.glsl"

uniform float scale;

const uint JUMP = 0u, THREE = 3u, TRUST = 5u;

struct Run {
    vec3 sum;
    float trust;
};

float code_of(uint bits) {
    uint number = bits & 0xFFFu, exponent = bits >> 12 & 7u;
    uint size = exponent == 0u ? number : (number | 0x1000u) << (exponent - 1u);
    return (bits & 0x8000u) == 0u ? float(size) : -float(size);
}

vec3 colour_of(uint bits) {
    vec2 parts = vec2(bits >> 12 & 0xFFFu, bits & 0xFFFu) / 4095.0;
    uint largest = bits >> 30;
    vec3 shares = largest == 0u ? vec3(1.0, parts) : largest == 1u ? vec3(parts.y, 1.0, parts.x) : vec3(parts, 1.0);
    return shares * uintBitsToFloat(((bits >> 24 & 63u) + 64u) << 23);
}

Run run_of(uint k, uint end, uint stride) {
    Run run = Run(vec3(0.0), 1.0);
    uint pixel = 0u;
    for (; k < end; k += stride) {
        uint word = word_at(k), kind = word & 7u;
        if (kind == JUMP) {
            pixel += word >> 3;
            continue;
        }
        if (kind == TRUST) {
            run.trust = float(word >> 16) / 32767.0;
            continue;
        }
        pixel += word >> 3 & 0x1FFFu;
        vec3 codes;
        if (kind == THREE) {
            k += stride;
            uint others = word_at(k);
            codes = vec3(code_of(word >> 16), code_of(others & 0xFFFFu), code_of(others >> 16));
        } else {
            codes = code_of(word >> 16) * vec3(kind & 1u, kind >> 1 & 1u, kind >> 2);
        }
        run.sum += codes * texelFetch(source, ivec2(pixel % uint(SOURCE_WIDTH), pixel / uint(SOURCE_WIDTH)), 0).rgb;
    }
    return run;
}

// The run's sum in the row's colour, if rows are COLOURED, combined with the base; trust and colour weigh a residual.
vec3 value_of(Run run, uint colour_bits, ivec2 at) {
    vec3 sum = scale * run.sum, weight = vec3(run.trust);
#ifdef COLOURED
    vec3 colour = colour_of(colour_bits);
    sum *= colour;
    weight *= colour;
#endif
    return combined(sum, at, weight);
}
