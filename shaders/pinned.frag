#version 330 core
// Places a picture by a projective map on black. The filter is a tent along each axis of the picture, as wide as a target
// pixel there and at least one source pixel. Edge pixels are weighted by their covered part.
//
// Inputs: `source`, linear RGB, row 0 at the top. With SCREEN also `across` and `down`, for x and y on a screen: the position
// that each target pixel sees, and its slopes along the target's x and y. All slopes are 0 for a pixel that sees no screen.
// Defines: MOST_TAPS along an axis; a wider filter takes every second sample, or every third …
// SCREEN, to place the picture on the positions that the target's pixels see.
// Output: linear RGB.
// Pass: player/passes/pinned.py.
uniform sampler2D source;
uniform mat3 to_source;    // target (or screen) position -> source position, pixels, homogeneous
const float TINY = 1e-12;  // smallest width to divide by, in pixels
#ifdef SCREEN
uniform sampler2D across, down;
#endif

out vec4 linear_rgb;

ivec3 taps(float centre, float radius, int count) {
    int first = max(int(ceil(centre - radius - 0.5)), 0);
    int last = min(int(floor(centre + radius - 0.5)), count - 1);
    return ivec3(first, last, max(int(ceil(2.0 * radius / float(MOST_TAPS))), 1));
}

float tent(int tap, float centre, float radius) {
    return max(0.0, 1.0 - abs(float(tap) + 0.5 - centre) / radius);
}

void main() {
    linear_rgb = vec4(0.0, 0.0, 0.0, 1.0);
#ifdef SCREEN
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec3 on_x = texelFetch(across, pixel, 0).rgb, on_y = texelFetch(down, pixel, 0).rgb;
    if (on_x.yz == vec2(0.0) && on_y.yz == vec2(0.0)) return;
    vec2 spot = vec2(on_x.x, on_y.x);
#else
    vec2 spot = gl_FragCoord.xy;
#endif
    vec3 place = to_source * vec3(spot, 1.0);
    if (place.z <= 0.0) return;
    vec2 at = place.xy / place.z;
    vec2 along_x = (to_source[0].xy - at * to_source[0].z) / place.z;
    vec2 along_y = (to_source[1].xy - at * to_source[1].z) / place.z;
#ifdef SCREEN
    mat2 along = mat2(along_x, along_y);
    along_x = along * vec2(on_x.y, on_y.y);
    along_y = along * vec2(on_x.z, on_y.z);
#endif
    vec2 width = max(sqrt(along_x * along_x + along_y * along_y), TINY);
    ivec2 size = textureSize(source, 0);
    vec2 inside = min(at, vec2(size) - at) / width;
    float cover = clamp(min(inside.x, inside.y) + 0.5, 0.0, 1.0);
    if (cover <= 0.0) return;
    vec2 radius = max(width, 1.0);
    ivec3 across = taps(at.x, radius.x, size.x), down = taps(at.y, radius.y, size.y);
    vec4 sum = vec4(0.0);
    for (int row = down[0]; row <= down[1]; row += down[2]) {
        float weight = tent(row, at.y, radius.y);
        for (int column = across[0]; column <= across[1]; column += across[2]) {
            sum += weight * tent(column, at.x, radius.x) * vec4(texelFetch(source, ivec2(column, row), 0).rgb, 1.0);
        }
    }
    if (sum.a > 0.0) linear_rgb.rgb = cover * sum.rgb / sum.a;
}
