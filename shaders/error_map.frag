#version 330 core
// Colours each camera pixel by its error: the light that the camera will see minus the target, in the worst channel.
//
// Inputs: `seen`, radiance; `b`, target of the projector's light; `ambient`; `reach`, output of reach.frag; `colours`,
//   linear light over the error from −span to span.
// Output: linear light, `white` times the colour; `uncounted` where reach's alpha is 0.
// Pass: player/passes/shown_maps.py.
uniform sampler2D seen, b, ambient, reach, colours;
uniform float white, span;
uniform vec3 uncounted;

out vec4 light;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 error = (texelFetch(seen, at, 0).rgb - texelFetch(ambient, at, 0).rgb - texelFetch(b, at, 0).rgb) / white;
    float worst = error.r;
    if (abs(error.g) > abs(worst)) worst = error.g;
    if (abs(error.b) > abs(worst)) worst = error.b;
    int last = textureSize(colours, 0).x - 1;
    float position = (clamp(worst / span, -1.0, 1.0) + 1.0) / 2.0 * float(last);
    int low = min(int(position), last - 1);
    vec3 colour = mix(texelFetch(colours, ivec2(low, 0), 0).rgb, texelFetch(colours, ivec2(low + 1, 0), 0).rgb,
                      position - float(low));
    light = vec4(white * (texelFetch(reach, at, 0).a > 0.0 ? colour : uncounted), 1.0);
}
