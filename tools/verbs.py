"""counterlight: measure or simulate the light transport of a room, invert it, and play through the inverse.

One command with verbs; each verb is a module, which is imported on demand.
"""

import importlib
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import counterlight
from counterlight.command import DONE, SCRIPTS, Parser, verb
from counterlight.errors import InputError, nearest

SHELLS = ("bash", "zsh", "fish")
COMPLETIONS = (
    'eval "$(counterlight completion bash)"',
    "counterlight completion fish > ~/.config/fish/completions/counterlight.fish",
)


class Verb(NamedTuple):
    """A module with a `main(argv)`, and its purpose."""

    module: str
    purpose: str


VERBS = {
    "play": Verb("app", "show media in a room, as they are meant to be seen"),
    "simulate": Verb("tools.simulate_transport", "compute a room from a described scene"),
    "acquire": Verb("tools.acquire_transport", "measure a room with projectors and cameras"),
    "import-transport": Verb("tools.import_transport", "make a room from matrices that were measured elsewhere"),
    "import-graycode": Verb("tools.import_graycode", "make a room from photographs of Gray-code patterns"),
    "import-pairs": Verb("tools.import_pairs", "make a room from ordinary pictures and their photographs"),
    "join": Verb("tools.join_projectors", "join rooms of several projectors, cameras or views"),
    "build": Verb("tools.build_correction_map", "compute the correction map, which the player needs"),
    "verify": Verb("tools.verify_projection", "check a room, or a compensated picture, with its camera"),
    "compensate": Verb("tools.compensate_image", "compute one projector picture by reference solvers"),
    "relight": Verb("tools.relight", "compute how a room looks under a picture"),
    "merge-exposures": Verb("tools.merge_exposures", "merge photographs into a radiance map"),
    "export": Verb("tools.export_room", "write warp, blend and colour for other programs"),
    "fit-response": Verb("tools.fit_projector_response", "fit a projector's response to measured grey levels"),
    "projector": Verb("tools.control_projectors", "switch projectors on and off, or print their state"),
    "study": Verb("tools.study_accuracy", "measure what accuracy costs in time"),
    "example": Verb("tools.show_example", "show a film in a shipped room, before and after"),
    "doctor": Verb("tools.check_machine", "check what this machine has, and what is missing"),
}


def _verb(name: str, argv: Sequence[str] | None) -> int:
    """Import and run a verb, inside `run`, so that Ctrl-C during the import ends cleanly."""
    body: Callable[[Sequence[str] | None], int] = importlib.import_module(f"counterlight.{VERBS[name].module}").main
    return body(argv)


# entry points of the scripts play-corrected and build-correction-map
play, build = verb(partial(_verb, "play")), verb(partial(_verb, "build"))


@verb
def main(argv: Sequence[str] | None) -> int:
    words = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    if "_ARGCOMPLETE" in os.environ:
        words = _being_completed()
    if words[0] in VERBS:
        return _verb(words[0], words[1:])
    if words[0] == "completion":
        print(_completion(words[1:]))
    elif words[0].startswith("-"):
        _parser().parse_args(words)
    else:
        known = [*VERBS, "completion"]
        raise InputError(f"counterlight: no verb {words[0]!r}{nearest(words[0], known)}; see counterlight --help")
    return DONE


def _completion(words: Sequence[str]) -> str:
    """Returns the text that a shell evaluates at startup: `eval "$(counterlight completion bash)"`."""
    purpose = "Print the shell code that completes verbs, options and files."
    parser = Parser("completion", description=purpose, examples=COMPLETIONS)
    parser.add_argument("shell", choices=SHELLS, help="shell that runs the code")
    shell = parser.parse_args(words).shell
    from argcomplete.shell_integration import shellcode

    return str(shellcode(["counterlight", *SCRIPTS.values()], shell=shell))


def _being_completed() -> list[str]:
    """Returns the complete words of the line being completed, for the verb to complete the rest."""
    line = os.environ["COMP_LINE"][: int(os.environ.get("COMP_POINT", "100000"))]
    try:
        words = shlex.split(line)
    except ValueError:  # the line has an open quotation
        words = line.split()
    if line[-1:].isspace():
        words.append("")
    words = words[1:-1]
    if words and words[0] in VERBS:
        os.environ["_ARGCOMPLETE"] = "2"  # index of the word with the program's name
        return words
    return ["--help"]


def _parser() -> Parser:
    lines = [f"  {name:<18}{verb.purpose}" for name, verb in VERBS.items()]
    lines.append(f"  {'completion':<18}print the shell code that completes verbs and options")
    parser = Parser("", description=_described(lines))
    parser.add_argument(
        "verb",
        nargs="?",
        choices=[*VERBS, "completion"],
        metavar="VERB",
        help="one of the verbs above; counterlight VERB --help explains it",
    )
    version = f"counterlight {counterlight.__version__}"
    parser.add_argument("--version", action="version", version=version, help="print the version")
    return parser


def _described(lines: Sequence[str]) -> str:
    return "\n".join([(__doc__ or "").split("\n")[0].partition(": ")[2], "", "verbs:", *lines])
