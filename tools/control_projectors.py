"""counterlight projector: switch projectors on and off over the network (PJLink), or print their state."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import BAD_INPUT, DONE, Parser, command_line, conclusion, tell, verb
from counterlight.errors import InputError
from counterlight.files.reading import read_bytes
from counterlight.show.schedule_file import read_schedule
from counterlight.unattended.cues import read_address
from counterlight.unattended.pjlink import PORT, Projector, status_of, switch

MOST_PASSWORD = 1024
FIX = "write the password alone into it"

EXAMPLES = (
    "counterlight projector status 192.168.1.20",
    "counterlight projector on 192.168.1.20 --password-file password.txt",
)


@verb
def main(argv: Sequence[str] | None) -> int:
    options = _parser().parse_args(argv)
    projectors = _projectors(options)
    if not projectors:
        raise InputError("counterlight projector: names no projector; add a HOST, or --schedule FILE")
    done = [_obeys(options.action, projector) for projector in projectors]  # continue after a projector that fails
    result = f"{sum(done)} of {len(done)} projectors {'answered' if options.action == 'status' else 'obeyed'}"
    show = command_line("play", "ROOM", "MEDIA", "--fullscreen")
    print(conclusion(result, show if options.action == "on" else command_line("projector", "on", "HOST")))
    return DONE if all(done) else BAD_INPUT


def _obeys(action: str, projector: Projector) -> bool:
    try:
        if action != "status":
            switch(projector, on=action == "on")
        print(f"projector {projector}: {status_of(projector)}")
    except InputError as error:
        tell(f"error: {error}")
        return False
    return True


def _projectors(options: argparse.Namespace) -> list[Projector]:
    found = [] if options.schedule is None else list(read_schedule(options.schedule).projectors)
    password = "" if options.password_file is None else _password(options.password_file)
    return found + [Projector(host, port, password) for host, port in options.projectors]


def _password(path: Path) -> str:
    try:
        return read_bytes(path, MOST_PASSWORD, FIX).decode().strip("\r\n")
    except UnicodeDecodeError:
        raise InputError(f"{path}: no UTF-8 text; {FIX}") from None


def _parser() -> Parser:
    parser = Parser("projector", description=__doc__, examples=EXAMPLES)
    parser.add_argument("action", choices=("status", "on", "off"), help="print the state, switch on, or switch off")
    parser.add_argument(
        "projectors",
        nargs="*",
        type=_address,
        metavar="HOST[:PORT]",
        help=f"addresses of projectors (default port {PORT})",
    )
    parser.add_argument(
        "--password-file", type=Path, metavar="FILE", help="read the password of these projectors from this file"
    )
    parser.add_argument("--schedule", type=Path, metavar="FILE", help="include the projectors of this schedule")
    return parser


def _address(word: str) -> tuple[str, int]:
    try:
        return read_address(word, port=PORT)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected HOST[:PORT], found {word!r}") from None
