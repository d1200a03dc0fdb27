#version 330 core
// Computes the means of the cells of a picture's parts, for the watcher (docs/watch.md).
//
// Inputs: `source`; `parts`, one row of three texels per part: (left, top, columns), (width, height, rows), and (extent in
// x, extent in y, 0). Cell i of n along an axis starts at pixel i · extent / n of the part, rounded down.
// Output: the means of the parts' cells, next to each other from the left; black below a part.
// Pass: player/passes/means.py.
uniform sampler2D source;
uniform sampler2D parts;

out vec4 mean;

ivec3 row_of(int part, int column) { return ivec3(texelFetch(parts, ivec2(column, part), 0).rgb); }

void main() {
    ivec2 cell = ivec2(gl_FragCoord.xy);
    int count = textureSize(parts, 0).y, part = 0;
    while (part < count && cell.x >= row_of(part, 0).z) cell.x -= row_of(part++, 0).z;
    mean = vec4(0.0, 0.0, 0.0, 1.0);
    if (part == count || cell.y >= row_of(part, 1).z) return;
    ivec2 origin = row_of(part, 0).xy, size = row_of(part, 1).xy, extent = row_of(part, 2).xy;
    ivec2 cells = ivec2(row_of(part, 0).z, row_of(part, 1).z);
    ivec2 first = min(cell * extent / cells, size), end = min((cell + 1) * extent / cells, size);
    vec3 sum = vec3(0.0);
    for (int y = first.y; y < end.y; ++y) {
        for (int x = first.x; x < end.x; ++x) sum += texelFetch(source, origin + ivec2(x, y), 0).rgb;
    }
    ivec2 sides = end - first;
    mean.rgb = sum / float(max(sides.x * sides.y, 1));
}
