"""counterlight export: the outputs, whole or not at all, and what the diagonal of T loses."""

from contextlib import ExitStack
from pathlib import Path

from counterlight.tools.api import Room, read_room
from counterlight.tools.exports.diagonal import Diagonal, diagonal, lost
from counterlight.tools.exports.files import ocio_config, stored_in_mpcdi, write_cube, write_mpcdi, write_st_map
from counterlight.writing.outputs import check_apart, check_file
from counterlight.writing.replacing import replacing_file


def export(folder: Path, mpcdi: Path | None, warp: Path | None, cube: Path | None) -> tuple[list[str], list[Path]]:
    """Write the named outputs of a calibration folder; returns the lines that describe them, and the written files."""
    room_files = [folder / "calibration.toml"]
    for path, suffix in ((mpcdi, ".mpcdi"), (warp, ".exr"), (cube, ".cube")):
        if path is not None:
            check_file(path, suffixes=(suffix,), inputs=room_files)
    room = read_room(folder)
    cubes, config = _colour_files(room, cube) if cube is not None else ([], None)
    for path in (*cubes, *([config] if config else [])):
        check_file(path, inputs=room_files)
    check_apart(mpcdi, warp, *cubes, config)
    written = [path for path in (mpcdi, warp, *cubes) if path is not None]
    lines = []
    with ExitStack() as stack:  # no file is put in place before all are written
        if mpcdi is not None or warp is not None:
            lines += _write_maps(stack, room, diagonal(room), mpcdi, warp)
        if config is not None:
            lines += _write_colour(stack, room, cubes, config)
    return lines, written


def _write_maps(stack: ExitStack, room: Room, exact: Diagonal, mpcdi: Path | None, warp: Path | None) -> list[str]:
    regions = room.calibration.regions
    covered = 100 * sum(float(exact.seen[region.part].sum()) for region in regions)
    covered /= sum(region.width * region.height for region in regions)
    lines = []
    judged = exact
    if mpcdi is not None:
        judged = stored_in_mpcdi(exact)
        write_mpcdi(stack.enter_context(replacing_file(mpcdi)), judged, regions)
        projectors = "1 projector" if len(regions) == 1 else f"{len(regions)} projectors"
        lines.append(f"{mpcdi}: {projectors}, {covered:.1f} % of the pixels are seen")
    if warp is not None:
        write_st_map(stack.enter_context(replacing_file(warp)), exact)
        lines.append(f"{warp}: {exact.seen.shape[1]}x{exact.seen.shape[0]}, {covered:.1f} % of its pixels are seen")
    warped, best = lost(room, judged)
    lines.append(
        f"a typical picture, over lit pixels: {warped:.1f} dB with this warp, {best:.1f} dB with the best drive; "
        f"{best - warped:.1f} dB are lost, because only the diagonal of T remains"
    )
    return lines


def _colour_files(room: Room, cube: Path) -> tuple[list[Path], Path]:
    """Return the paths of the tables, one per projector, and of the OpenColorIO configuration."""
    projectors = room.calibration.projectors
    several = len(projectors) > 1
    cubes = [cube.with_stem(f"{cube.stem}_{n}") if several else cube for n, _ in enumerate(projectors, 1)]
    return cubes, cube.with_suffix(".ocio")


def _write_colour(stack: ExitStack, room: Room, cubes: list[Path], config: Path) -> list[str]:
    for path, projector in zip(cubes, room.calibration.projectors, strict=True):
        write_cube(stack.enter_context(replacing_file(path)), projector)
    stack.enter_context(replacing_file(config)).write_text(ocio_config([path.name for path in cubes]))
    return [f"{', '.join(map(str, cubes))}: sRGB-encoded drive to code values; {config}: for OpenColorIO"]
