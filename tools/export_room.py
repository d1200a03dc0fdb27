"""counterlight export: write a room's warp, blend, black level and colour for other programs."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, conclusion, verb
from counterlight.errors import InputError

MEANING = """Other programs warp a picture and scale its pixels. Of T, only the diagonal remains: a place, a factor and
an offset per projector pixel. The command prints how many dB a typical picture loses. docs/exports.md has a recipe per
program."""

EXAMPLES = (
    "counterlight export room --mpcdi room.mpcdi",
    "counterlight export room --warp warp.exr --cube colour.cube",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.exports.export import export

    outputs = {"--mpcdi": options.mpcdi, "--warp": options.warp, "--cube": options.cube}
    if not any(outputs.values()):
        raise InputError(f"counterlight export: nothing to write; name a file with {', '.join(outputs)}")
    lines, written = export(options.calibration, options.mpcdi, options.warp, options.cube)
    print("\n".join(lines))
    action = "load the result by your program's recipe in docs/exports.md"
    print(conclusion(f"{' and '.join(map(str, written))}: written for other programs", action))


def _parser() -> argparse.ArgumentParser:
    parser = Parser("export", description=f"{__doc__}\n\n{MEANING}", examples=EXAMPLES)
    parser.add_argument("calibration", type=Path, help="calibration folder")
    parser.add_argument(
        "--mpcdi",
        type=Path,
        metavar="FILE.mpcdi",
        help="write warp, blend and black level of all projectors as MPCDI 2.0, profile 2d",
    )
    parser.add_argument(
        "--warp",
        type=Path,
        metavar="FILE.exr",
        help="write an ST map of the projectors' raster for compositors, with blend and black level as layers",
    )
    parser.add_argument(
        "--cube",
        type=Path,
        metavar="FILE.cube",
        help="write each projector's colour table, and an OpenColorIO configuration FILE.ocio; several projectors get "
        "FILE_1.cube, FILE_2.cube and so on",
    )
    return parser
