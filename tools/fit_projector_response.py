"""counterlight fit-response: fit a projector's response to measured grey levels, for --response of other verbs."""

from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, verb
from counterlight.writing.outputs import check_file

EXAMPLES = (
    "counterlight fit-response levels.csv -o response.toml",
    "counterlight fit-response ramp --camera-response srgb -o response.toml",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.response import named_response
    from counterlight.tools.hdr.camera_response import SUFFIXES, write_response
    from counterlight.tools.hdr.grey_ramp import read_ramp
    from counterlight.tools.hdr.projector_response import fit_projector_response

    check_file(options.output, suffixes=SUFFIXES, inputs=[options.source, Path(options.camera_response)])
    levels, light = read_ramp(options.source, named_response(options.camera_response))
    fitted = fit_projector_response(levels, light)
    write_response(options.output, fitted.response, {"black_level": list(fitted.black_level)})
    print(f"{options.output}: {len(levels)} readings, {fitted}")
    action = command_line("acquire", "--camera", "CAMERA", "--response", options.output, "-o", "ROOM")
    print(conclusion(f"{options.output}: the projector's response", action))


def _parser() -> Parser:
    parser = Parser("fit-response", description=__doc__, examples=EXAMPLES)
    parser.add_argument(
        "source",
        type=Path,
        help="table with columns level,red,green,blue or level,grey (.csv; levels 0 to 255, linear light), or folder "
        "of pictures named by their level, such as ramp_128.png (.png, .jpg or .exr)",
    )
    parser.add_argument(
        "--camera-response",
        default="linear",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help="undo this curve of the camera in .png and .jpg pictures (default linear)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE.toml", help="write the response to this file"
    )
    return parser
