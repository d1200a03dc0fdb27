"""counterlight merge-exposures: merge photographs of one scene with different exposure times into a radiance map."""

import argparse
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, verb
from counterlight.tools.choices import MERGES, WEIGHTINGS

EXAMPLES = (
    "counterlight merge-exposures a.jpg b.jpg c.jpg -o radiance.exr",
    "counterlight merge-exposures a.png b.png --times 1/30 1/8 -o radiance.exr",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.hdr.merging import ResponseSource, merge_bracket
    from counterlight.tools.hdr.radiance import MergeOptions

    summary = merge_bracket(
        options.pictures,
        options.output,
        times_s=options.times,
        source=ResponseSource.asked(options.response, options.pictures),
        options=MergeOptions(options.method, options.weighting, options.gpu),
        save_response=options.save_response,
    )
    print(f"{options.output}: {summary}")
    action = command_line("compensate", "ROOM", options.output, "-o", "FILE")
    print(conclusion(f"{options.output}: merged from {len(options.pictures)} pictures", action))


def _parser() -> argparse.ArgumentParser:
    parser = Parser("merge-exposures", description=__doc__, examples=EXAMPLES)
    parser.add_argument("pictures", type=Path, nargs="+", help="photographs by a fixed camera: PNG, JPEG or camera RAW")
    parser.add_argument(
        "--times",
        type=_seconds,
        nargs="+",
        metavar="SECONDS",
        help="set the exposure time of each picture, such as 0.125 or 1/8 (default: from EXIF)",
    )
    parser.add_argument(
        "--response",
        metavar="debevec|robertson|linear|srgb|GAMMA|FILE.toml",
        help="undo this curve of the camera; debevec and robertson recover it from the pictures (default debevec; RAW: "
        "linear)",
    )
    parser.add_argument("--save-response", type=Path, metavar="FILE.toml", help="also write the response to this file")
    parser.add_argument(
        "--method",
        default="debevec",
        choices=MERGES,
        help="merge by the mean of log radiance (debevec), the most likely radiance (robertson), or the mean of shots "
        "of one exposure (average) (default debevec)",
    )
    parser.add_argument(
        "--weighting",
        choices=WEIGHTINGS,
        help="weight code values by this curve (default: hat for debevec, gaussian for robertson)",
    )
    parser.add_argument("--gpu", action="store_true", help="merge with OpenGL")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE.exr", help="write the radiance map here"
    )
    return parser


def _seconds(text: str) -> float:
    try:
        return float(Fraction(text))
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f"a time is in seconds, such as 0.125 or 1/8, found {text!r}") from None
