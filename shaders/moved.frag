#version 330 core
// A drive for projectors whose pictures have moved since the calibration: each pixel shows what the place that it lights
// now was meant to get, between four by four pixels (Catmull and Rom 1974), over what is left of its light.
//
// Inputs: `drive`, linear RGB, 0..1; `projectors`, a row for each, five texels: the rows of N, (left, width, height) of
// its region, its gain g. N takes a position of its pixels to one of the calibrated region, homogeneous, in pixels.
// Output: drive, 0..1; as much of it as a pixel's share that falls on the calibrated raster: nobody knows what is beside.
// CPU twin: moved in player/pipeline/drift.py.
uniform sampler2D drive;
uniform sampler2D projectors;

out vec4 shown;

vec3 row_of(int projector, int column) { return texelFetch(projectors, ivec2(column, projector), 0).rgb; }

vec4 catmull_rom(float t) {
    return vec4(((2.0 - t) * t - 1.0) * t, (3.0 * t - 5.0) * t * t + 2.0, ((4.0 - 3.0 * t) * t + 1.0) * t,
                (t - 1.0) * t * t) * 0.5;
}

void main() {
    int last = textureSize(projectors, 0).y - 1, projector = 0;
    while (projector < last && gl_FragCoord.x > row_of(projector + 1, 3).x) ++projector;
    vec3 region = row_of(projector, 3);
    shown = vec4(0.0, 0.0, 0.0, 1.0);
    vec3 own = vec3(gl_FragCoord.x - region.x, gl_FragCoord.y, 1.0);
    float scale = dot(row_of(projector, 2), own);
    if (own.y > region.z || scale <= 0.0) return;
    vec2 at = vec2(dot(row_of(projector, 0), own), dot(row_of(projector, 1), own)) / scale - 0.5;
    vec2 lands = clamp(min(at, region.yz - 1.0 - at) + 1.0, 0.0, 1.0);
    if (lands.x * lands.y <= 0.0) return;
    ivec2 first = ivec2(floor(at)), most = ivec2(region.yz) - 1;
    vec4 across = catmull_rom(at.x - float(first.x)), down = catmull_rom(at.y - float(first.y));
    vec3 sum = vec3(0.0);
    for (int i = 0; i < 4; ++i) {
        int y = clamp(first.y + i - 1, 0, most.y);
        for (int j = 0; j < 4; ++j) {
            int x = clamp(first.x + j - 1, 0, most.x) + int(region.x);
            sum += down[i] * across[j] * texelFetch(drive, ivec2(x, y), 0).rgb;
        }
    }
    shown.rgb = clamp(lands.x * lands.y * sum / row_of(projector, 4), 0.0, 1.0);
}
