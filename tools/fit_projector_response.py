"""counterlight fit-response: a projector's response from measured grey levels, for --response of the other commands."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, run
from counterlight.writing.outputs import check_file


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.response import named_response
    from counterlight.tools.hdr.grey_ramp import read_ramp
    from counterlight.tools.hdr.projector_response import fit_projector_response
    from counterlight.tools.hdr.response_table import SUFFIXES, write_response

    check_file(options.output, suffixes=SUFFIXES, inputs=[options.source, Path(options.camera_response)])
    levels, light = read_ramp(options.source, named_response(options.camera_response))
    fitted = fit_projector_response(levels, light)
    write_response(options.output, fitted.response, {"black_level": list(fitted.black_level)})
    print(f"{options.output}: {len(levels)} readings, {fitted}")


def _parser() -> argparse.ArgumentParser:
    parser = Parser("fit-response", description=__doc__)
    parser.add_argument(
        "source",
        type=Path,
        help="a table with the columns level,red,green,blue or level,grey (.csv; levels 0 to 255, linear light), or a "
        "folder of pictures named by their level (ramp_000.png … ramp_255.png; .png, .jpg, or .exr of merge-exposures)",
    )
    parser.add_argument(
        "--camera-response",
        default="linear",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help="of .png and .jpg pictures (default linear)",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.toml")
    return parser


if __name__ == "__main__":
    sys.exit(main())
