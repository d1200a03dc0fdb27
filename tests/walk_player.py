"""The player in a real window with a remote inside, for tests/gl/test_player_walk.py.

python -m tests.walk_player watch ROOM MEDIA…            prints the session's state, a JSON line whenever it changes
python -m tests.walk_player run CALLS.json ROOM MEDIA…   makes the calls and prints each answer as a JSON line
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from counterlight.show.command_line import read_options
from counterlight.show.from_options import adjustments_of, room_of
from counterlight.show.in_window import play_in_window
from counterlight.show.registry import CommandError, Commands

LOOPS_BETWEEN = 4
NOT_WATCHED = ("volume", "mute", "watch-freeze", "gap", "psnr", "frames", "dropped", "fps", "late-frames", "monitor")


class Watcher:
    """Prints the properties whenever one has changed."""

    def __init__(self) -> None:
        self._before: dict[str, Any] = {}

    def poll(self, commands: Commands) -> None:
        if not commands.get("frames"):  # no medium plays yet
            return
        state = {name: commands.get(name) for name in commands.properties() if name not in NOT_WATCHED}
        if state != self._before:
            print(json.dumps(state), flush=True)
            self._before = state


class Caller:
    """Makes one call every few loops, so that its effect is drawn, and quits after the last call."""

    def __init__(self, calls: list[list[Any]]) -> None:
        self._calls: Iterator[list[Any]] = iter(calls)
        self._loops = 0

    def poll(self, commands: Commands) -> None:
        self._loops += commands.get("frames") > 0
        if self._loops % LOOPS_BETWEEN != 1:
            return
        self._loops += 1
        call = next(self._calls, None)
        if call is None:
            commands.run("quit")
            return
        what, name, *arguments = call
        try:
            result = {"get": commands.get, "set": commands.set, "run": commands.run}[what](name, *arguments)
            print(json.dumps({"call": call, "result": result}), flush=True)
        except CommandError as error:
            print(json.dumps({"call": call, "error": str(error)}), flush=True)


def main(mode: str, *arguments: str) -> None:
    remote: Watcher | Caller
    if mode == "run":
        remote = Caller(json.loads(Path(arguments[0]).read_text()))
        arguments = arguments[1:]
    else:
        remote = Watcher()
    options = read_options(["--no-config", *arguments], "")
    play_in_window(options, room_of(options), adjustments_of(options), remotes=[remote])


if __name__ == "__main__":
    main(*sys.argv[1:])
