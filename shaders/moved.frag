#version 330 core
// Corrects a drive for projectors whose pictures have moved since the calibration. Each pixel shows the drive of the place
// that it lights now, interpolated between six by six pixels (Keys 1981), divided by the remaining light.
//
// Inputs: `drive`, linear RGB, 0..1; `projectors`, one row of six texels per projector: the rows of N, (left, top) and
// (width, height) of its region, its gain g. N maps a position of its pixels to the calibrated region, homogeneous, pixels.
// Output: drive, 0..1. Beyond the calibrated raster, where the room is unknown, the drive is mirrored and fades out.
// Pass: player/passes/moved.py.
uniform sampler2D drive;
uniform sampler2D projectors;

out vec4 shown;

const float WHOLE = 1.0, FADE = 2.0; // pixels, as in the CPU function

vec3 row_of(int projector, int column) { return texelFetch(projectors, ivec2(column, projector), 0).rgb; }

float keys(float x) {
    x = abs(x);
    if (x < 1.0) return (4.0 * x - 7.0) * x * x / 3.0 + 1.0;
    return x < 2.0 ? ((36.0 - 7.0 * x) * x - 59.0) * x / 12.0 + 2.5 : ((x - 8.0) * x + 21.0) * x / 12.0 - 1.5;
}

int mirrored(int index, int last) { return clamp(last - abs(last - abs(index)), 0, last); }

void main() {
    int count = textureSize(projectors, 0).y, projector = 0;
    shown = vec4(0.0, 0.0, 0.0, 1.0);
    vec2 origin, size;
    vec3 own;
    for (; projector < count; ++projector) {
        origin = row_of(projector, 3).xy;
        size = row_of(projector, 4).xy;
        own = vec3(gl_FragCoord.xy - origin, 1.0);
        if (all(greaterThan(own.xy, vec2(0.0))) && all(lessThan(own.xy, size))) break;
    }
    if (projector == count) return;
    float scale = dot(row_of(projector, 2), own);
    if (scale <= 0.0) return;
    vec2 at = vec2(dot(row_of(projector, 0), own), dot(row_of(projector, 1), own)) / scale - 0.5;
    vec2 lands = clamp(1.0 + (min(at, size - 1.0 - at) + 0.5 + WHOLE) / FADE, 0.0, 1.0);
    if (lands.x * lands.y <= 0.0) return;
    ivec2 first = ivec2(floor(at)), most = ivec2(size) - 1;
    vec2 between = at - vec2(first);
    vec3 sum = vec3(0.0);
    for (int i = -2; i <= 3; ++i) {
        int y = mirrored(first.y + i, most.y) + int(origin.y);
        vec3 line = vec3(0.0);
        for (int j = -2; j <= 3; ++j) {
            int x = mirrored(first.x + j, most.x) + int(origin.x);
            line += keys(between.x - float(j)) * texelFetch(drive, ivec2(x, y), 0).rgb;
        }
        sum += keys(between.y - float(i)) * line;
    }
    shown.rgb = clamp(lands.x * lands.y * sum / row_of(projector, 5), 0.0, 1.0);
}
