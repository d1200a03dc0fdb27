"""The one exception that a user is meant to read, and words for it."""

import difflib
from collections.abc import Iterable

LONGEST, LONGEST_REASON = 80, 200  # characters of what a file, or a library, says


class InputError(Exception):
    """Wrong use or bad input: one line that says what, where, expected and found, and what to do.

    A command prints it as `error: …` and ends with exit code 2 (`counterlight.command`).
    """


def shown(value: object) -> str:
    """A value as a message shows it, cut where it has no end."""
    return one_line(repr(value), LONGEST)


def one_line(text: object, longest: int = LONGEST_REASON) -> str:
    """A text or an error in one line, cut where it has no end; the kind of error where it says nothing."""
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= longest else f"{line[:longest]}…"


def nearest(name: str, known: Iterable[str], closeness: float = 0.5) -> str:
    """`; did you mean NAME?` if a known name is as close (0 to 1, difflib's ratio), else nothing."""
    close = difflib.get_close_matches(name, list(known), 1, closeness)
    return f"; did you mean {close[0]!r}?" if close else ""


def printable(text: str) -> str:
    """A text whose every character a terminal shows, and obeys none: what a file is called is not ours to say."""
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)
