"""counterlight merge-exposures: a radiance map from photographs of one scene with different exposure times."""

import argparse
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from counterlight.command import Parser, run
from counterlight.tools.choices import MERGES, WEIGHTINGS


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
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


def _parser() -> argparse.ArgumentParser:
    parser = Parser("merge-exposures", description=__doc__)
    parser.add_argument("pictures", type=Path, nargs="+", help="PNG, JPEG or camera RAW, from one fixed camera")
    parser.add_argument(
        "--times",
        type=_seconds,
        nargs="+",
        metavar="SECONDS",
        help="exposure time of each picture, such as 0.125 or 1/8 (default: from the pictures' EXIF)",
    )
    parser.add_argument(
        "--response",
        metavar="debevec|robertson|linear|srgb|GAMMA|FILE.toml",
        help="the camera's: recovered from the bracket by one of two methods, or known (default debevec; RAW: linear)",
    )
    parser.add_argument("--save-response", type=Path, metavar="FILE.toml", help="write the response, too")
    parser.add_argument(
        "--method",
        default="debevec",
        choices=MERGES,
        help="mean of log radiance; most likely radiance; mean of shots of one exposure (default debevec)",
    )
    parser.add_argument(
        "--weighting",
        choices=WEIGHTINGS,
        help="trust in a code value (default: hat for debevec, gaussian for robertson)",
    )
    parser.add_argument("--gpu", action="store_true", help="merge in OpenGL")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.exr")
    return parser


def _seconds(text: str) -> float:
    try:
        return float(Fraction(text))
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f"a time is in seconds, such as 0.125 or 1/8, found {text!r}") from None


if __name__ == "__main__":
    sys.exit(main())
