"""counterlight import-pairs: make a calibration from ordinary pictures and their photographs."""

import time
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, parse_size, verb
from counterlight.response import named_response

EXAMPLES = (
    "counterlight import-pairs pictures photographs -o room",
    "counterlight import-pairs pictures photographs --quality fit.png -o room",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.pairs.room import PairsOptions, import_pairs_room

    start = time.monotonic()
    pairs_options = PairsOptions(
        options.pairs,
        options.black,
        named_response(options.camera_response) if options.camera_response else None,
        options.camera[::-1] if options.camera else None,
        options.quality,
    )
    summary = import_pairs_room(
        options.pictures, options.photographs, options.output, pairs_options, name=options.name, force=options.force
    )
    print(f"{options.output}: {summary}")
    result = f"{options.output}: imported in {time.monotonic() - start:.1f} s, {summary.expected.short}"
    print(conclusion(result, command_line("build", options.output)))


def _parser() -> Parser:
    parser = Parser("import-pairs", description=__doc__, examples=EXAMPLES)
    parser.add_argument("pictures", type=Path, help="folder of the pictures that the projector showed, of its size")
    parser.add_argument("photographs", type=Path, help="folder of their photographs: PNG, JPEG or camera RAW")
    parser.add_argument(
        "--pairs",
        type=Path,
        metavar="LIST",
        help="match by this text file, with a picture and a photograph per line, separated by a comma "
        "(default: matching numbers in the names, otherwise the content)",
    )
    parser.add_argument(
        "--black", type=Path, metavar="FILE", help="photograph of a black picture (default: estimated from the pairs)"
    )
    parser.add_argument(
        "--camera",
        type=parse_size,
        metavar="WxH",
        help="reduce the photographs to this size (default: to at most 640 pixels on the longer side)",
    )
    parser.add_argument(
        "--camera-response",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help="undo this curve of the camera (default: linear for RAW and 16 bits, srgb for 8 bits)",
    )
    parser.add_argument(
        "--quality",
        type=Path,
        metavar="FILE.png",
        help="draw a held-out capture, its prediction, and ten times their difference",
    )
    parser.add_argument("--name", help="name the room (default: as the folder)")
    parser.add_argument("--force", action="store_true", help="replace an existing calibration")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="write the calibration here")
    return parser
