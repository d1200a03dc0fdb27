#version 330 core
// Places a picture along one axis of a target. The tent filter is as wide as a target pixel and at least one source pixel,
// so it blurs little and aliases little. Two passes, x then y, place a picture.
//
// Inputs: `source`, linear RGB, row 0 at the top.
// Output: linear RGB; black outside the placed interval.
// Pass: player/passes/resample.py.
uniform sampler2D source;
uniform int axis;          // 0: x, 1: y
uniform float origin;      // where the picture starts along the axis, target pixels
uniform float extent;      // length of the picture along the axis, target pixels

out vec4 linear_rgb;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    int count = textureSize(source, 0)[axis];
    float scale = float(count) / extent;
    float centre = (float(at[axis]) + 0.5 - origin) * scale;
    float radius = max(scale, 1.0);
    vec4 sum = vec4(0.0);
    if (centre > 0.0 && centre < float(count)) {
        int first = max(int(ceil(centre - radius - 0.5)), 0);
        int last = min(int(floor(centre + radius - 0.5)), count - 1);
        ivec2 from = at;
        for (int k = first; k <= last; ++k) {
            from[axis] = k;
            float weight = max(0.0, 1.0 - abs(float(k) + 0.5 - centre) / radius);
            sum += weight * vec4(texelFetch(source, from, 0).rgb, 1.0);
        }
    }
    linear_rgb = vec4(sum.a > 0.0 ? sum.rgb / sum.a : vec3(0.0), 1.0);
}
