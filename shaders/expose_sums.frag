#version 330 core
// Adds BATCH exposures to the two sums of a radiance estimate (thesis 3.3.2, eq. 3.4 and 3.6).
//
// Inputs: `codes`, code values as a stream of samples (row, column, channel), four per texel, the exposures below each
//   other, ROWS texels apart; `table`, (p, q) of each code value, 256 of each channel per row, or `curve`, the same for
//   8 bit; `limits`, f⁻¹(TOP) of each channel; `sums`, `weights` and `bounds`, results of earlier passes; `exposures`,
//   (α, β, γ, 1/t) of each.
// Defines: BATCH, a compile-time number because a loop that is not unrolled took twice as long on llvmpipe; ROWS;
//   CHANNELS; TOP, the lowest code that counts as clipped; CURVE_IN_UNIFORMS, `curve` instead of `table`: a fifth less
//   time on llvmpipe.
// Output: Σ α p + β q, Σ γ q and the greatest lower bound of four samples.
// CPU function: CpuSums in tools/hdr/estimators.py.
// Pass: player/gl/exposure_sums.py.
uniform usampler2D codes;
#ifdef CURVE_IN_UNIFORMS
uniform vec2 curve[256 * CHANNELS];
#else
uniform sampler2D table;
#endif
uniform sampler2D sums;
uniform sampler2D weights;
uniform sampler2D bounds;
uniform vec4 exposures[BATCH];
uniform float limits[CHANNELS];
uniform bool first;

layout(location = 0) out vec4 sum;
layout(location = 1) out vec4 weight;
layout(location = 2) out vec4 bound;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    sum = first ? vec4(0.0) : texelFetch(sums, at, 0);
    weight = first ? vec4(0.0) : texelFetch(weights, at, 0);
    bound = first ? vec4(0.0) : texelFetch(bounds, at, 0);
    ivec4 channel = (4 * at.x + ivec4(0, 1, 2, 3)) % CHANNELS;  // rows hold whole pixels
    ivec4 column = 256 * channel;
    vec4 limit = vec4(limits[channel.x], limits[channel.y], limits[channel.z], limits[channel.w]);
    for (int j = 0; j < BATCH; ++j) {
        uvec4 z = texelFetch(codes, ivec2(at.x, at.y + j * ROWS), 0);
        vec4 exposure = exposures[j];
        bound = max(bound, exposure.a * limit * vec4(greaterThanEqual(z, uvec4(TOP))));
        for (int k = 0; k < 4; ++k) {
#ifdef CURVE_IN_UNIFORMS
            vec2 entry = curve[int(z[k]) + column[k]];
#else
            vec2 entry = texelFetch(table, ivec2(int(z[k] & 255u) + column[k], int(z[k] >> 8u)), 0).rg;
#endif
            sum[k] += exposure.r * entry.r + exposure.g * entry.g;
            weight[k] += exposure.b * entry.g;
        }
    }
}
