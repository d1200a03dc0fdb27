"""Keys bound to commands, as in mpv wherever mpv has the function, and the help page that lists them.

A key's name is the character that it types, or "space", "left", "right", "up", "down", "escape", "enter", "tab",
"backspace", "pageup", "pagedown", "home", "end". The prefix "ctrl+" may precede any name. The prefix "shift+" may
precede only the words, because a character already contains shift. The mouse has "double-click" and "wheel-up",
"-down", "-left", "-right". The default bindings of the mouse need Ctrl, because an accidental touch must not change a
show. While the picture is being placed, PLACING has priority. options.py binds the keys of options.
"""

import shlex
from collections.abc import Mapping
from itertools import groupby

from counterlight.errors import InputError, nearest
from counterlight.show.options import OPTIONS
from counterlight.show.registry import PROPERTY_COMMANDS, CommandError, Commands

CTRL, SHIFT = "ctrl+", "shift+"
NAMES = (
    *("space", "left", "right", "up", "down", "escape", "enter", "tab", "backspace"),
    *("pageup", "pagedown", "home", "end", "double-click", "wheel-up", "wheel-down", "wheel-left", "wheel-right"),
)
OF_OPTIONS = [(key, *bound) for row in OPTIONS.values() for key, bound in row.keys.items()]
KEYS = {
    "space": "cycle pause",
    "p": "cycle pause",
    "left": "seek -5",
    "right": "seek 5",
    "down": "seek -60",
    "up": "seek 60",
    "ctrl+wheel-left": "seek -5",
    "ctrl+wheel-right": "seek 5",
    ".": "frame-step",
    ",": "frame-back-step",
    "<": "playlist-prev",
    ">": "playlist-next",
    "l": "ab-loop",
    "L": "cycle loop-file",
    "s": "screenshot",
    "o": "show-progress",
    "i": "cycle stats",
    "?": "show-keys",
    **{key: command for key, command, _ in OF_OPTIONS},
    "g": "identify",
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
MEANINGS = {
    **{command: meaning for _, command, meaning in OF_OPTIONS},
    "cycle pause": "pause",
    "seek -5": "5 s back",
    "seek 5": "5 s forward",
    "seek -60": "a minute back",
    "seek 60": "a minute forward",
    "frame-step": "next frame, then pause",
    "frame-back-step": "frame before, then pause",
    "playlist-prev": "medium before",
    "playlist-next": "next medium",
    "ab-loop": "A-B loop: set A, set B, clear",
    "cycle loop-file": "begin the medium again at its end",
    "screenshot": "save the view, without what is written over it",
    "show-progress": "where the medium is",
    "cycle stats": "statistics, with a histogram of how late frames were",
    "show-keys": "list the keys",
    "identify": "number, name and size on every monitor",
    "place": "place the picture in the camera's view",
    "reload": "read the maps and compile the shaders again",
    "quit": "end",
    "place-move -0.01 0": "move by a hundredth of the camera's view",
    "place-move 0.01 0": "move by a hundredth of the camera's view",
    "place-move 0 -0.01": "move by a hundredth of the camera's view",
    "place-move 0 0.01": "move by a hundredth of the camera's view",
    "place-move -0.001 0": "by a thousandth",
    "place-move 0.001 0": "by a thousandth",
    "place-move 0 -0.001": "by a thousandth",
    "place-move 0 0.001": "by a thousandth",
    "place-scale 1.02": "larger",
    "place-scale 0.98": "smaller",
    "place-corner": "select the next corner, or the whole picture",
    "place-undo": "take the last change back",
    "place-fit": "as large as fits",
    "place-save": "keep it",
    "place-cancel": "as it was",
}
ASIDE = ("stats", "help")  # a change of these properties is visible anyway, so no message is shown


class Keys:
    """Runs the command that a key is bound to, and returns a line for the screen."""

    def __init__(self, commands: Commands, bindings: Mapping[str, str] | None = None) -> None:
        """Take the bindings of the settings file, which replace the defaults. An empty command unbinds a key.

        Raises InputError for a binding that could never run.
        """
        for key, line in (bindings or {}).items():
            try:
                if line.strip():
                    commands.check(*shlex.split(line))
            except CommandError as error:
                raise InputError(f"settings, key {key!r}: {error}") from None
        self._commands = commands
        self._bindings = {key: words for key, words in {**KEYS, **(bindings or {})}.items() if words.strip()}

    def press(self, key: str, *, placing: bool) -> str:
        """Run the key's command, and return the line for the screen or "". Unknown keys do nothing."""
        line = (PLACING.get(key) if placing else None) or self._bindings.get(key)
        if line is None:
            return ""
        try:
            name, *words = shlex.split(line)
            result = self._commands.run(name, *words)
            if name in PROPERTY_COMMANDS:
                return "" if words[0] in ASIDE else self._commands.tell(words[0])
            return result if isinstance(result, str) else ""
        except (CommandError, ValueError) as error:
            return str(error)

    def help_cells(self, *, placing: bool) -> list[str]:
        """Return cells "KEYS<tab>MEANING". Neighbouring keys with the same meaning share a cell."""
        table = PLACING if placing else self._bindings
        meaning = groupby(table.items(), key=lambda pair: MEANINGS.get(pair[1], pair[1]))
        return [f"{'  '.join(key for key, _ in pairs)}\t{words}" for words, pairs in meaning]


def check_bindings(bindings: Mapping[str, object]) -> dict[str, str]:
    """Return a settings file's table of keys. Raises CommandError for an unknown key or a malformed command."""
    for key, words in bindings.items():
        bare = key.removeprefix(CTRL if key.startswith(CTRL) else SHIFT)
        if bare not in NAMES and (len(bare) != 1 or key.startswith(SHIFT)):
            raise CommandError(f"no key {key!r}{nearest(bare, NAMES)}; a key is a character, {', '.join(NAMES)}")
        if not isinstance(words, str):
            raise CommandError(f"key {key!r}: expected a command as text, found {words!r}")
        try:
            shlex.split(words)
        except ValueError as error:
            raise CommandError(f"key {key!r}: {error}") from None
    return dict(bindings)  # type: ignore[arg-type]
