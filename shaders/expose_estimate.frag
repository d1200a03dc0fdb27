#version 330 core
// Estimates the radiance of four samples from their two sums (thesis eq. 3.4 and 3.6).
//
// Inputs: `sums`, `weights` and `bounds`, outputs of expose_sums.frag.
// Defines: EXPONENTIAL: the quotient is ln E.
// Output: E where the weight is above 0 and E is at least `slack` times the bound. Elsewhere minus the bound, which is
//   0 where only black was seen. An E below the bound would contradict an exposure that clips.
// CPU function: CpuSums.estimate in tools/hdr/estimators.py.
// Pass: player/gl/exposure_sums.py.
uniform sampler2D sums;
uniform sampler2D weights;
uniform sampler2D bounds;
uniform float slack;

out vec4 estimate;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 sum = texelFetch(sums, at, 0);
    vec4 weight = texelFetch(weights, at, 0);
    vec4 bound = texelFetch(bounds, at, 0);
    for (int k = 0; k < 4; ++k) {
        float quotient = weight[k] > 0.0 ? sum[k] / weight[k] : 0.0;
#ifdef EXPONENTIAL
        quotient = exp(quotient);
#endif
        estimate[k] = weight[k] > 0.0 && quotient >= slack * bound[k] ? quotient : -bound[k];
    }
}
