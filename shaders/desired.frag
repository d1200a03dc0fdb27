#version 330 core
// What the projector must add: b = white · picture − e (thesis eq. 5.1).
//
// Inputs: `picture`, linear RGB; `ambient`, radiance of the same size.
// Defines: CLAMP limits the result to 0..1 (a picture that goes to the projector as it is, with black as ambient);
//   REACH knows `reach`, e + T·1, and in alpha whether a camera pixel counts: no other is asked for more than it can have;
//   TONE asks for s (k + (1 − k) unit · picture) + o instead of the picture, k the black level, (s, o) the one texel of
//   `tone` (player/pipeline/content.py).
// Output: b, radiance, of their size.
// CPU twin: desired_light in player/pipeline/reference.py.
uniform sampler2D picture;
uniform sampler2D ambient;
uniform float white;
#ifdef REACH
uniform sampler2D reach;
#endif
#ifdef TONE
uniform sampler2D tone;
uniform float unit, black_level;
#endif

out vec4 b;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 asked = texelFetch(picture, at, 0).rgb;
#ifdef TONE
    vec2 affine = texelFetch(tone, ivec2(0), 0).rg;
    asked = affine.x * (black_level + (1.0 - black_level) * (unit * asked)) + affine.y;
#endif
    vec3 light = white * asked - texelFetch(ambient, at, 0).rgb;
#ifdef REACH
    vec4 had = texelFetch(reach, at, 0);
    if (had.a == 0.0) light = clamp(light, vec3(0.0), max(had.rgb - texelFetch(ambient, at, 0).rgb, 0.0));
#endif
#ifdef CLAMP
    light = clamp(light, 0.0, 1.0);
#endif
    b = vec4(light, 1.0);
}
