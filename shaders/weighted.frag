#version 330 core
// Multiplies a picture by weights: errors by the trust in a camera pixel, drives by the share that no camera sees.
//
// Inputs: `picture`; `weights`, of its size.
// Defines: SQUARED squares the picture first.
// Output: their product.
// Pass: player/passes/certificate.py.
uniform sampler2D picture, weights;

out vec4 product;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 value = texelFetch(picture, at, 0).rgb;
#ifdef SQUARED
    value *= value;
#endif
    product = vec4(value * texelFetch(weights, at, 0).rgb, 1.0);
}
