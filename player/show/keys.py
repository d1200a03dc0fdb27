"""Keys bound to commands: mpv's keys where mpv has the function, ours else; and the help page that lists them.

A key's name is the character that it types, "space", "left", "right", "up", "down", "escape", "enter", "tab",
"backspace", "pageup", "pagedown", "home", "end", or one of these after "ctrl+" or "shift+" (characters after "ctrl+"
only: shift is in the character). While the picture is being placed, PLACING comes first.
"""

import shlex
from collections.abc import Mapping
from itertools import groupby

from counterlight.show.registry import CommandError, Commands

KEYS = {
    "space": "cycle pause",
    "p": "cycle pause",
    "left": "seek -5",
    "right": "seek 5",
    "down": "seek -60",
    "up": "seek 60",
    ".": "frame-step",
    ",": "frame-back-step",
    "<": "playlist-prev",
    ">": "playlist-next",
    "l": "ab-loop",
    "L": "cycle loop-file",
    "f": "cycle fullscreen",
    "escape": "set fullscreen no",
    "s": "screenshot",
    "i": "cycle stats",
    "?": "cycle help",
    "1": "add contrast -1",
    "2": "add contrast 1",
    "3": "add brightness -1",
    "4": "add brightness 1",
    "5": "add gamma -1",
    "6": "add gamma 1",
    "7": "add saturation -1",
    "8": "add saturation 1",
    "9": "add volume -2",
    "0": "add volume 2",
    "m": "cycle mute",
    "c": "cycle compensation",
    "v": "cycle view",
    "b": "cycle blackout",
    "t": "cycle test-card",
    "g": "identify",
    "x": "cycle clipping",
    "[": "multiply refine 0.5",
    "]": "multiply refine 2",
    "k": "place",
    "ctrl+r": "reload",
    "q": "quit",
}
PLACING = {
    "left": "place-move -0.01 0",
    "right": "place-move 0.01 0",
    "up": "place-move 0 -0.01",
    "down": "place-move 0 0.01",
    "shift+left": "place-move -0.001 0",
    "shift+right": "place-move 0.001 0",
    "shift+up": "place-move 0 -0.001",
    "shift+down": "place-move 0 0.001",
    "+": "place-scale 1.02",
    "=": "place-scale 1.02",
    "-": "place-scale 0.98",
    "tab": "place-corner",
    "u": "place-undo",
    "ctrl+z": "place-undo",
    "backspace": "place-fit",
    "k": "place-save",
    "enter": "place-save",
    "escape": "place-cancel",
}
ASIDE = ("stats", "help")  # what shows itself needs no word on the screen


class Keys:
    """Turns a pressed key into a command, and what it did into a line for the screen."""

    def __init__(self, commands: Commands, bindings: Mapping[str, str] | None = None) -> None:
        """bindings : of the settings file, in place of ours; an empty command unbinds a key."""
        self._commands = commands
        self._bindings = {key: words for key, words in {**KEYS, **(bindings or {})}.items() if words}

    def press(self, key: str, *, placing: bool) -> str:
        """Run what the key is bound to; what the screen should say, or nothing. Unknown keys do nothing."""
        line = (PLACING.get(key) if placing else None) or self._bindings.get(key)
        if line is None:
            return ""
        try:
            name, *words = shlex.split(line)
            result = self._commands.run(name, *words)
            if name in ("set", "cycle", "add", "multiply"):
                return "" if words[0] in ASIDE else self._commands.tell(words[0])
            return result if isinstance(result, str) else ""
        except (CommandError, ValueError) as error:
            return str(error)

    def help_lines(self, *, placing: bool) -> list[str]:
        """Keys and their command, a tab apart, in two columns; keys that follow each other and do the same share it."""
        table = PLACING if placing else self._bindings
        cells = [
            f"{'  '.join(key for key, _ in pairs)}\t{words}"
            for words, pairs in groupby(table.items(), key=lambda pair: pair[1])
        ]
        half = (len(cells) + 1) // 2
        return ["\t".join(pair) for pair in zip(cells[:half], [*cells[half:], ""], strict=False)]


def check_bindings(bindings: Mapping[str, object]) -> dict[str, str]:
    """A settings file's table of keys; CommandError for what is no command line."""
    for key, words in bindings.items():
        if not isinstance(words, str):
            raise CommandError(f"key {key!r}: expected a command as text, found {words!r}")
        try:
            shlex.split(words)
        except ValueError as error:
            raise CommandError(f"key {key!r}: {error}") from None
    return dict(bindings)  # type: ignore[arg-type]
