#version 330 core
// One accelerated projected gradient step towards min ½‖T p − b‖², 0 ≤ p ≤ 1 (player/pipeline/refinement.py).
//
// Inputs, all of the projector's size: `descent`, Tᵀ(b − T y); `y`, where it was taken; `p`, the drive of the step before;
//   `step_size`, 1 / (TᵀT·1), 0 where no camera pixel is lit, which keeps the pixel dark.
// Outputs: `next_p`, the drive, 0..1; `next_y`, where the next step looks.
// CPU twin: refinement_step in player/pipeline/reference.py.
uniform sampler2D descent, y, p, step_size;
uniform float momentum, over_relaxation;

layout(location = 0) out vec4 next_p;
layout(location = 1) out vec4 next_y;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 from = texelFetch(y, at, 0).rgb, size = texelFetch(step_size, at, 0).rgb;
    vec3 q = clamp(from + size * texelFetch(descent, at, 0).rgb, 0.0, 1.0) * vec3(greaterThan(size, vec3(0.0)));
    next_p = vec4(q, 1.0);
    next_y = vec4(q + momentum * (q - texelFetch(p, at, 0).rgb) + over_relaxation * (q - from), 1.0);
}
