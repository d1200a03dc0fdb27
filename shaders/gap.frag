#version 330 core
// Computes each projector pixel's share of the gap Σ max(g p, g (p − 1)), which bounds the distance to the best drive.
//
// Inputs: `descent`, −g = Tᵀ(b − T p); `p`, the drive; of one size.
// Output: the share, ≥ 0, of the inputs' size.
// Pass: player/passes/certificate.py.
uniform sampler2D descent, p;

out vec4 share;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 down = texelFetch(descent, at, 0).rgb, drive = texelFetch(p, at, 0).rgb;
    share = vec4(max(-down * drive, down * (1.0 - drive)), 1.0);
}
