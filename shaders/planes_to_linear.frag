#version 330 core
// Converts decoded planes to linear RGB, upright.
//
// Inputs: three single-channel planes, integer codes (or float radiance), row 0 at the top; `transfer`, a table of linear
//   light over the code value 0..1 (width samples, height 1).
// Defines: LAYOUT_YUV, LAYOUT_RGB or LAYOUT_RADIANCE.
//   LUT maps codes through `lut`, a table by red, green and blue whose first sample is at the code `lut_low`.
//   RENDITION converts HDR or wide primaries to the screen (player/pipeline/signal.py); `gain` is a table over the
//   fourth root of light in shares of `top`.
// Output: linear RGB, 0..1 (radiance unchanged), one texel per displayed pixel.
// Pass: player/passes/planes_to_linear.py.
#ifdef LAYOUT_RADIANCE
uniform sampler2D plane_0, plane_1, plane_2;
#else
uniform usampler2D plane_0, plane_1, plane_2;
#endif
#ifndef LAYOUT_RADIANCE
uniform sampler2D transfer;
#endif
#ifdef LUT
uniform sampler3D lut;
uniform vec3 lut_low, lut_span;
#endif
#ifdef RENDITION
uniform sampler2D gain;
uniform float ootf, top;       // HLG's system gamma minus 1; light of the medium's peak
uniform mat3 to_screen;        // from the medium's primaries to the screen's
#endif
uniform ivec2 stored_size;     // of plane 0, before rotation
uniform ivec2 chroma_size;     // of planes 1 and 2
uniform ivec2 subsampling;     // luma pixels per chroma sample
uniform vec2 chroma_offset;    // chroma coordinate of luma pixel 0
uniform vec3 black, span;      // code values of 0 and of 1 per component
uniform mat3 to_rgb;
uniform float lift;            // added to every code: brightness
uniform int quarter_turns;     // counter-clockwise, applied for display

out vec4 linear_rgb;

ivec2 stored_position(ivec2 shown) {
    ivec2 last = stored_size - 1;
    if (quarter_turns == 1) return ivec2(last.x - shown.y, shown.x);
    if (quarter_turns == 2) return last - shown;
    if (quarter_turns == 3) return ivec2(shown.y, last.y - shown.x);
    return shown;
}

#ifdef LAYOUT_YUV
vec2 chroma(ivec2 at) {
    vec2 position = vec2(at) / vec2(subsampling) + chroma_offset;
    ivec2 low = ivec2(floor(position));
    vec2 share = position - vec2(low);
    ivec2 last = chroma_size - 1;
    ivec2 a = clamp(low, ivec2(0), last), b = clamp(low + 1, ivec2(0), last);
    vec2 upper = mix(vec2(texelFetch(plane_1, a, 0).r, texelFetch(plane_2, a, 0).r),
                     vec2(texelFetch(plane_1, ivec2(b.x, a.y), 0).r, texelFetch(plane_2, ivec2(b.x, a.y), 0).r), share.x);
    vec2 lower = mix(vec2(texelFetch(plane_1, ivec2(a.x, b.y), 0).r, texelFetch(plane_2, ivec2(a.x, b.y), 0).r),
                     vec2(texelFetch(plane_1, b, 0).r, texelFetch(plane_2, b, 0).r), share.x);
    return mix(upper, lower, share.y);
}
#endif

#ifndef LAYOUT_RADIANCE
float looked_up(sampler2D table, float share) {
    int last = textureSize(table, 0).x - 1;
    float position = clamp(share, 0.0, 1.0) * float(last);
    int low = min(int(position), last - 1);
    return mix(texelFetch(table, ivec2(low, 0), 0).r, texelFetch(table, ivec2(low + 1, 0), 0).r,
               position - float(low));
}
#endif

#ifdef LUT
vec3 tetrahedral(vec3 code) {
    int last = textureSize(lut, 0).x - 1;
    vec3 position = float(last) * clamp((code - lut_low) / lut_span, 0.0, 1.0);
    ivec3 corner = min(ivec3(position), last - 1);
    vec3 share = position - vec3(corner);
    float most = max(max(share.r, share.g), share.b), least = min(min(share.r, share.g), share.b);
    float middle = share.r + share.g + share.b - most - least;
    ivec3 first = share.r == most ? ivec3(1, 0, 0) : share.g == most ? ivec3(0, 1, 0) : ivec3(0, 0, 1);
    ivec3 not_last = share.b == least ? ivec3(1, 1, 0) : share.g == least ? ivec3(1, 0, 1) : ivec3(0, 1, 1);
    return (1.0 - most) * texelFetch(lut, corner, 0).rgb + (most - middle) * texelFetch(lut, corner + first, 0).rgb
         + (middle - least) * texelFetch(lut, corner + not_last, 0).rgb + least * texelFetch(lut, corner + 1, 0).rgb;
}
#endif

#ifdef RENDITION
const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722), LUMINANCE_2020 = vec3(0.2627, 0.6780, 0.0593);
const float LEAST = 1e-6;  // smallest denominator

vec3 within_gamut(vec3 colour) {
    float grey = clamp(dot(colour, LUMINANCE), 0.0, 1.0);
    float least = min(min(colour.r, colour.g), colour.b), most = max(max(colour.r, colour.g), colour.b);
    float low = least < 0.0 ? grey / max(grey - least, LEAST) : 1.0;
    float high = most > 1.0 ? (1.0 - grey) / max(most - grey, LEAST) : 1.0;
    return clamp(grey + min(low, high) * (colour - grey), 0.0, 1.0);
}

vec3 on_screen(vec3 light) {
    if (ootf != 0.0) light *= pow(max(dot(light, LUMINANCE_2020), LEAST), ootf);
    float brightest = max(max(light.r, light.g), light.b);
    light *= looked_up(gain, sqrt(sqrt(brightest / top))) * top / max(brightest, top);
    return within_gamut(to_screen * light);
}
#endif

void main() {
    ivec2 at = stored_position(ivec2(gl_FragCoord.xy));
    float first = float(texelFetch(plane_0, at, 0).r);
#ifdef LAYOUT_YUV
    vec3 samples = vec3(first, chroma(at));
#else
    vec3 samples = vec3(first, texelFetch(plane_1, at, 0).r, texelFetch(plane_2, at, 0).r);
#endif
#ifdef LAYOUT_RADIANCE
    linear_rgb = vec4(samples, 1.0);
#else
    vec3 code = to_rgb * ((samples - black) / span) + lift;
#ifdef LUT
    code = tetrahedral(clamp(code, 0.0, 1.0));
#endif
    vec3 light = vec3(looked_up(transfer, code.r), looked_up(transfer, code.g), looked_up(transfer, code.b));
#ifdef RENDITION
    light = on_screen(light);
#endif
    linear_rgb = vec4(light, 1.0);
#endif
}
