#version 330 core
// Shows two pictures in halves: the left half of one, the right half of the other, a white line between.
//
// Inputs: `left`, `right`, linear RGB of one size.
// Output: linear RGB of that size.
// Pass: player/passes/shown_maps.py.
uniform sampler2D left, right;
uniform float line;        // light of the dividing line

out vec4 linear_rgb;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int middle = textureSize(left, 0).x / 2;
    vec3 light = at.x < middle ? texelFetch(left, at, 0).rgb : texelFetch(right, at, 0).rgb;
    linear_rgb = vec4(at.x == middle ? vec3(line) : light, 1.0);
}
