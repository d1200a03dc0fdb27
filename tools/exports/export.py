"""counterlight export: the outputs, whole or not at all, and what the diagonal of T loses."""

from pathlib import Path

from counterlight.tools.api import Room, read_room
from counterlight.tools.exports.diagonal import Diagonal, diagonal, lost
from counterlight.tools.exports.files import ocio_config, stored_in_mpcdi, write_cube, write_mpcdi, write_st_map
from counterlight.writing.outputs import check_apart, check_file
from counterlight.writing.replacing import replacing_file


def export(folder: Path, mpcdi: Path | None, warp: Path | None, cube: Path | None) -> str:
    """Write the named outputs of a calibration folder; returns the lines that describe them."""
    room_files = [folder / "calibration.toml"]
    for path, suffix in ((mpcdi, ".mpcdi"), (warp, ".exr"), (cube, ".cube")):
        if path is not None:
            check_file(path, suffixes=(suffix,), inputs=room_files)
    check_apart(mpcdi, warp, cube)
    room = read_room(folder)
    lines = []
    if mpcdi is not None or warp is not None:
        lines += _write_maps(room, diagonal(room), mpcdi, warp)
    if cube is not None:
        lines += _write_colour(room, cube)
    return "\n".join(lines)


def _write_maps(room: Room, kept: Diagonal, mpcdi: Path | None, warp: Path | None) -> list[str]:
    regions = room.calibration.regions
    covered = 100 * sum(float(kept.seen[region.part].sum()) for region in regions)
    covered /= sum(region.width * region.height for region in regions)
    lines = []
    if mpcdi is not None:
        kept = stored_in_mpcdi(kept)
        with replacing_file(mpcdi) as temporary:
            write_mpcdi(temporary, kept, regions)
        lines.append(f"{mpcdi}: {len(regions)} projectors, {covered:.1f} % of their pixels are seen")
    if warp is not None:
        with replacing_file(warp) as temporary:
            write_st_map(temporary, kept)
        lines.append(f"{warp}: {kept.seen.shape[1]}x{kept.seen.shape[0]}, {covered:.1f} % of its pixels are seen")
    warped, best = lost(room, kept)
    lines.append(
        f"a typical picture: {warped:.1f} dB with this warp, {best:.1f} dB with the best drive; {best - warped:.1f} dB "
        "are lost, because only the diagonal of T remains"
    )
    return lines


def _write_colour(room: Room, cube: Path) -> list[str]:
    projectors = room.calibration.projectors
    several = len(projectors) > 1
    paths = [cube.with_stem(f"{cube.stem}_{n}") if several else cube for n, _ in enumerate(projectors, 1)]
    config = cube.with_suffix(".ocio")
    for path in (*paths, config):
        check_file(path)
    for path, projector in zip(paths, projectors, strict=True):
        with replacing_file(path) as temporary:
            write_cube(temporary, projector)
    with replacing_file(config) as temporary:
        temporary.write_text(ocio_config([path.name for path in paths]))
    return [f"{', '.join(map(str, paths))}: sRGB-encoded drive to code values; {config}: for OpenColorIO"]
