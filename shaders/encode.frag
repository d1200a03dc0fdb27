#version 330 core
// Converts linear light to code values of 8 bit or of the screen: own primaries, inverse response, then dithering.
//
// Inputs: `picture`, linear RGB; `inverse_response`, code values over √light 0..1 (width samples, one row per projector);
// `of_column` with SEVERAL: each column's row in these tables (width of the picture, one texel row per row of projectors);
// `colours` with MIXED: matrix from shared to own primaries (3 columns of RGB, one row per projector); `segments` with
// SEGMENT, two rows per projector: the darkest primary over √light, and the white segment's light, which is subtracted
// from the primaries, over the square root of that primary; `processing` with PROCESSED: 1 / √B over √light (blue along
// x; one texel row per projector, red and green).
// Defines: SEVERAL, the height of a row of projectors, if projectors differ; MIXED; SEGMENT; PROCESSED, the samples of
// B per primary; DITHER_ORDERED (8×8 Bayer), DITHER_NOISE (a hash of pixel, channel and frame), or neither: rounding.
// Output: code / highest.
// Pass: player/passes/encode.py.
uniform sampler2D picture;
uniform sampler2D inverse_response;
#ifdef SEVERAL
uniform usampler2D of_column;
#endif
#ifdef MIXED
uniform sampler2D colours;
#endif
#ifdef SEGMENT
uniform sampler2D segments;
#endif
#ifdef PROCESSED
uniform sampler2D processing;
#endif
uniform float scale;      // light of a white pixel, 1 for drive
uniform float highest;    // code: 255, of 10 bits 1023
#ifdef DITHER_NOISE
uniform uint frame;
#endif

out vec4 encoded;

vec3 looked_up(sampler2D table, vec3 root, int row) {
    int last = textureSize(table, 0).x - 1;
    vec3 position = root * float(last);
    ivec3 low = min(ivec3(position), last - 1);
    vec3 share = position - vec3(low);
    vec3 found;
    for (int i = 0; i < 3; ++i) {
        found[i] = mix(texelFetch(table, ivec2(low[i], row), 0)[i],
                       texelFetch(table, ivec2(low[i] + 1, row), 0)[i], share[i]);
    }
    return found;
}

#ifdef PROCESSED
vec3 processed(vec3 root, int row) {
    vec3 position = root * float(PROCESSED - 1);
    ivec3 low = min(ivec3(position), PROCESSED - 2);
    vec3 share = position - vec3(low), found = vec3(0.0);
    for (int corner = 0; corner < 8; ++corner) {
        ivec3 next = ivec3(corner & 1, (corner >> 1) & 1, corner >> 2);
        vec3 weight = mix(1.0 - share, share, vec3(next));
        ivec3 at = low + next;
        ivec2 texel = ivec2(at.b, (row * PROCESSED + at.r) * PROCESSED + at.g);
        found += weight.r * weight.g * weight.b * texelFetch(processing, texel, 0).rgb;
    }
    return min(root * found, 1.0);
}
#endif

vec3 code_of(vec3 light, int row) {
    vec3 root = sqrt(clamp(light, 0.0, 1.0));
#ifdef SEGMENT
    vec3 each = looked_up(segments, root, 2 * row);
    vec3 segment = looked_up(segments, vec3(sqrt(min(min(each.r, each.g), each.b))), 2 * row + 1);
    root = sqrt(max(root * root - segment, 0.0));
#endif
#ifdef PROCESSED
    root = processed(root, row);
#endif
    return looked_up(inverse_response, root, row);
}

#if defined(DITHER_ORDERED)
vec3 threshold(ivec2 at) {
    // The Bayer matrix by bit interleaving: bits of x^y and y, from the lowest up, become the rank's highest bits.
    int x = at.x ^ at.y, y = at.y, rank = 0;
    for (int bit = 0; bit < 3; ++bit) {
        rank = (rank << 2) | (((x >> bit) & 1) << 1) | ((y >> bit) & 1);
    }
    return vec3((float(rank) + 0.5) / 64.0);
}
#elif defined(DITHER_NOISE)
uint scramble(uint v) {  // the PCG hash (Jarzynski and Olano 2020)
    v = v * 747796405u + 2891336453u;
    v = ((v >> ((v >> 28u) + 4u)) ^ v) * 277803737u;
    return (v >> 22u) ^ v;
}
vec3 threshold(ivec2 at) {
    uint seed = scramble(uint(at.x) + scramble(uint(at.y) + scramble(frame)));
    uvec3 noise = uvec3(scramble(seed), scramble(seed + 1u), scramble(seed + 2u));
    return (vec3(noise >> 9u) + 0.5) / 8388608.0;
}
#else
vec3 threshold(ivec2 at) { return vec3(0.5); }
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int row = 0;
#ifdef SEVERAL
    row = int(texelFetch(of_column, ivec2(at.x, at.y / SEVERAL), 0).r);
#endif
    vec3 light = texelFetch(picture, at, 0).rgb;
#ifdef MIXED
    light = vec3(dot(texelFetch(colours, ivec2(0, row), 0).rgb, light),
                 dot(texelFetch(colours, ivec2(1, row), 0).rgb, light),
                 dot(texelFetch(colours, ivec2(2, row), 0).rgb, light));
#endif
    vec3 code = code_of(light / scale, row);
    encoded = vec4(floor(min(code * highest + threshold(at), highest)) / highest, 1.0);
}
