#version 330 core
// Computes one over a picture, and 0 where the picture is 0: step sizes from curvatures (player/pipeline/view_blend.py).
//
// Input: `picture`, ≥ 0.
// Output: 1 / picture, or 0, of its size.
// Pass: player/passes/certificate.py.
uniform sampler2D picture;

out vec4 result;

void main() {
    vec3 value = texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb;
    result = vec4(mix(vec3(0.0), 1.0 / max(value, vec3(1e-37)), greaterThan(value, vec3(0.0))), 1.0);
}
