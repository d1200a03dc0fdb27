#version 330 core
// Computes the light that the projector must add, b = white · picture − e (thesis eq. 5.1), in mixed primaries.
//
// Inputs: `picture`, linear RGB; `ambient`, radiance of the same size.
// Defines: CLAMP limits the result to 0..1, for an uncorrected picture with black as ambient.
//   TONE replaces the picture by s (k + (1 − k) unit · picture) + o. k is the black level, and (s, o) is the one texel of
//   `tone` (player/pipeline/content.py).
//   WEIGHTS multiplies the picture by `weights`, the inverse of changes of the room's light.
//   MIXED multiplies the light by each pixel's matrix, `row_red`, `row_green`, `row_blue` (player/maps/mixing.py).
//   FULL limits the light to what each pixel can reach by itself, 0 to `full`, T·1. With MIXED, the result is the light
//   within these limits that the camera sees nearest to the target; `squares` is Q Qᵀ.
// Output: b, radiance, of the inputs' size.
// Pass: player/passes/desired.py.
uniform sampler2D picture;
uniform sampler2D ambient;
uniform float white;
#ifdef FULL
uniform sampler2D full;
#endif
#ifdef TONE
uniform sampler2D tone;
uniform float unit, black_level;
#endif
#ifdef WEIGHTS
uniform sampler2D weights;
#endif
#ifdef MIXED
uniform sampler2D row_red, row_green, row_blue;
#ifdef FULL
uniform mat3 squares;

const int SWEEPS = 3;

// Applies one limit after another; other primaries compensate for a limited one (nearest in player/maps/mixing.py).
vec3 nearest(vec3 light, vec3 most, mat3 rows) {
    if (light == clamp(light, vec3(0.0), most)) return light;
    mat3 spread = transpose(rows) * squares * rows;
    vec3 moved = vec3(0.0);
    for (int turn = 0; turn < 3 * SWEEPS; turn++) {
        int primary = turn % 3;
        float own = spread[primary][primary], alone = light[primary] - own * moved[primary];
        float more = (clamp(alone, 0.0, most[primary]) - alone) / own - moved[primary];
        light += spread[primary] * more;
        moved[primary] += more;
    }
    return light;
}
#endif
#endif

out vec4 b;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 asked = texelFetch(picture, at, 0).rgb;
#ifdef TONE
    vec2 affine = texelFetch(tone, ivec2(0), 0).rg;
    asked = affine.x * (black_level + (1.0 - black_level) * (unit * asked)) + affine.y;
#endif
#ifdef WEIGHTS
    asked *= texelFetch(weights, at, 0).rgb;
#endif
    vec3 light = white * asked - texelFetch(ambient, at, 0).rgb;
#ifdef MIXED
    mat3 rows = mat3(texelFetch(row_red, at, 0).rgb, texelFetch(row_green, at, 0).rgb, texelFetch(row_blue, at, 0).rgb);
    light = light * rows;
#ifdef FULL
    light = nearest(light, texelFetch(full, at, 0).rgb, rows);
#endif
#endif
#ifdef FULL
    light = clamp(light, vec3(0.0), texelFetch(full, at, 0).rgb);
#endif
#ifdef CLAMP
    light = clamp(light, 0.0, 1.0);
#endif
    b = vec4(light, 1.0);
}
