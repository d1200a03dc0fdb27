#version 330 core
// Draws the finished picture, or a part of it, upright into the window (OpenGL's windows start at the bottom), with the overlay.
//
// Inputs: `picture`, encoded RGB; `overlay`, RGBA text of its own size, at the window's upper left, alpha 0 outside text.
// Output: the window's pixels.
uniform sampler2D picture;
uniform sampler2D overlay;
uniform ivec2 window_size;
uniform ivec4 region;      // left, top, width, height of the shown part of the picture
uniform ivec4 place;       // left, top, width, height of this part in the window

out vec4 encoded;

void main() {
    ivec2 at = ivec2(int(gl_FragCoord.x), window_size.y - 1 - int(gl_FragCoord.y));
    ivec2 inside = at - place.xy;
    vec3 code = vec3(0.0);
    if (all(greaterThanEqual(inside, ivec2(0))) && all(lessThan(inside, place.zw))) {
        code = texelFetch(picture, region.xy + inside * region.zw / place.zw, 0).rgb;
    }
    if (all(lessThan(at, textureSize(overlay, 0)))) {
        vec4 text = texelFetch(overlay, at, 0);
        code = mix(code, text.rgb, text.a);
    }
    encoded = vec4(code, 1.0);
}
