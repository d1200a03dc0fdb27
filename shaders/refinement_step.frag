#version 330 core
// Takes one accelerated projected gradient step towards min ½ Σ w (T p − b)² + ½ pᵀP p, 0 ≤ p ≤ 1 (player/pipeline/refinement.py).
//
// Inputs, all of the projector's size: `descent`, TᵀW(b − T y); `y`, the point of that gradient; `damping`, `right` and
//   `down`, the parts of P: η and the ties to the pixels on the right and below (player/maps/prior.py); `p`, the drive
//   of the step before; `step_size`, 0 where no camera pixel is lit, which keeps the pixel dark.
// Outputs: `next_p`, the drive, 0..1; `next_y`, the point of the next gradient.
// Defines: SLOPE outputs only `slope`, TᵀW(b − T y) − P y.
// Pass: player/passes/refinement_step.py.
uniform sampler2D descent, y, damping, right, down;
#ifdef SLOPE
out vec4 slope;
#else
uniform sampler2D p, step_size;
uniform float momentum, over_relaxation;

layout(location = 0) out vec4 next_p;
layout(location = 1) out vec4 next_y;
#endif

vec3 tied(sampler2D ties, ivec2 pixel, ivec2 neighbour, vec3 from) {  // pull on `from` by the tie stored at `pixel`
    return texelFetch(ties, pixel, 0).rgb * (from - texelFetch(y, neighbour, 0).rgb);
}

vec3 pull(ivec2 at, vec3 from) {  // P y
    ivec2 last = textureSize(y, 0) - 1, x = ivec2(1, 0), below = ivec2(0, 1);
    vec3 sum = texelFetch(damping, at, 0).rgb * from;
    if (at.x < last.x) sum += tied(right, at, at + x, from);
    if (at.y < last.y) sum += tied(down, at, at + below, from);
    if (at.x > 0) sum += tied(right, at - x, at - x, from);
    if (at.y > 0) sum += tied(down, at - below, at - below, from);
    return sum;
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 from = texelFetch(y, at, 0).rgb, downhill = texelFetch(descent, at, 0).rgb - pull(at, from);
#ifdef SLOPE
    slope = vec4(downhill, 1.0);
#else
    vec3 size = texelFetch(step_size, at, 0).rgb;
    vec3 q = clamp(from + size * downhill, 0.0, 1.0) * vec3(greaterThan(size, vec3(0.0)));
    next_p = vec4(q, 1.0);
    next_y = vec4(q + momentum * (q - texelFetch(p, at, 0).rgb) + over_relaxation * (q - from), 1.0);
#endif
}
