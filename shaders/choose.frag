#version 330 core
// Chooses the first of 16 candidates whose sum is at most 0, interpolated linearly towards the candidate before it.
//
// Inputs: `sums`, 1 × 4 texels of four values; `candidates`, 16 values. With SCALES also `tone`, whose second value is the
//   offset found before, and `before`, the (s, o) of the last frame.
// Defines: SCALES: candidates are shares of the greatest scale; if no sum is at most 0, the least sum wins. Without SCALES,
//   candidates are offsets; if no sum is at most 0, the last candidate wins.
// Output: (1, o). With SCALES, (s, o), approached from `before` by the share `approach`.
// Pass: player/passes/adaptation.py.
uniform sampler2D sums, candidates;
#ifdef SCALES
uniform sampler2D tone, before;
uniform float approach;
#endif

out vec4 chosen;

float sum(int i) { return texelFetch(sums, ivec2(0, i / 4), 0)[i % 4]; }
float candidate(int i) { return texelFetch(candidates, ivec2(i, 0), 0).r; }

float choose() {
    int best = 15;
    for (int i = 0; i < 16; ++i) {
        if (sum(i) <= 0.0) {
            if (i == 0) return candidate(0);
            float share = sum(i - 1) / (sum(i - 1) - sum(i));
            return candidate(i - 1) + share * (candidate(i) - candidate(i - 1));
        }
#ifdef SCALES
        if (i == 0 || sum(i) < sum(best)) best = i;
#endif
    }
    return candidate(best);
}

void main() {
#ifdef SCALES
    float offset = texelFetch(tone, ivec2(0), 0).g;
    vec2 found = vec2((1.0 - offset) * choose(), offset);
    chosen = vec4(mix(texelFetch(before, ivec2(0), 0).rg, found, approach), 0.0, 1.0);
#else
    chosen = vec4(1.0, choose(), 0.0, 1.0);
#endif
}
