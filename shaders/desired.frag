#version 330 core
// What the projector must add: b = white · picture − e (thesis eq. 5.1).
//
// Inputs: `picture`, linear RGB; `ambient`, radiance of the same size.
// Defines: CLAMP limits the result to 0..1 (a picture that goes to the projector as it is, with black as ambient).
// Output: b, radiance, of their size.
// CPU twin: desired_light in player/reference.py.
uniform sampler2D picture;
uniform sampler2D ambient;
uniform float white;

out vec4 b;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 light = white * texelFetch(picture, at, 0).rgb - texelFetch(ambient, at, 0).rgb;
#ifdef CLAMP
    light = clamp(light, 0.0, 1.0);
#endif
    b = vec4(light, 1.0);
}
