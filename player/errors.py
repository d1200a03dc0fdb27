"""InputError and AbsentError, whose messages users read; DrawingError; and functions that format messages."""

import difflib
from collections.abc import Iterable

LONGEST, LONGEST_REASON = 80, 200  # characters of a value from a file, and of a library's message


class InputError(Exception):
    """Wrong use or bad input. The message is one line: what, where, expected and found, and what to do.

    A command prints it as `error: …` and ends with exit code 2 (`counterlight.command`).
    """


class AbsentError(InputError):
    """A part that may still appear is missing: a screen, a monitor or its mode, a folder on a disk.

    A supervised player waits for it (`counterlight.unattended.waiting`).
    """


class DrawingError(RuntimeError):
    """A backend cannot draw a pass: an internal fault, or an edited shader."""


def shown(value: object) -> str:
    """Return a value for a message, cut if it is long."""
    return one_line(repr(value), LONGEST)


def one_line(text: object, longest: int = LONGEST_REASON) -> str:
    """Return a text or an error in one line, cut if it is long. Without text, return the name of the type."""
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= longest else f"{line[:longest]}…"


def nearest(name: str, known: Iterable[str], closeness: float = 0.5) -> str:
    """Return `; did you mean NAME?` for the closest known name, or "" if none is close enough.

    closeness : 0 to 1, difflib's ratio.
    """
    close = difflib.get_close_matches(name, list(known), 1, closeness)
    return f"; did you mean {close[0]!r}?" if close else ""


def printable(text: str) -> str:
    """Escape the characters that a terminal does not print, because a file name may contain control characters."""
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)
