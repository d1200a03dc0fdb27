"""Records captures and decisions of the watcher (`--watch-record`) in a folder of limited size.

Names begin with the local time and the state. `…-capture.png` is the capture. `…-shown.png` has the reduced
projector pictures during the exposure. `…-blocks.png` has the measured next to the predicted blocks, relative to white.
`states.jsonl` has a line of JSON for every change of the state, and every EVERY_S.
"""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.passes.encode import encoded
from counterlight.response import Response
from counterlight.tools.watching.watcher import Sight
from counterlight.unattended.json_lines import encode
from counterlight.unattended.watch_link import Answer

EVERY_S, PAUSE_S = 60.0, 10.0  # seconds between pictures: without a change of the state, and with one
MOST_BYTES = 256 << 20  # limit for all pictures
MOST_LINES = 4 << 20  # most bytes of each of the two files
STATES, OLDER = "states.jsonl", "states-older.jsonl"


class Record:
    """Keeps answers and captures in a folder. Raises OSError if the folder cannot be written."""

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self._folder, self._most = folder, most_bytes
        self._state, self._told_s, self._pictured_s = "", -np.inf, -np.inf

    def keep(self, now_s: float, answer: Answer, look: Callable[[], Sight | None]) -> None:
        """Keep an answer, and what `look` returns, if they are due at `now_s`, seconds since 1970."""
        changed, since_s = answer.state != self._state, now_s - self._pictured_s
        name = ""
        sight = look() if since_s >= EVERY_S or (changed and since_s >= PAUSE_S) else None
        if sight is not None:
            name = time.strftime("%Y%m%d-%H%M%S-", time.localtime(now_s)) + answer.state.replace(" ", "-")
            self._pictured_s = now_s
            self._draw(name, sight)
            self._shrink()
        if changed or name or now_s - self._told_s >= EVERY_S:
            self._state, self._told_s = answer.state, now_s
            self._tell({"time": round(now_s, 1), "pictures": name, **asdict(answer)})

    def _draw(self, name: str, sight: Sight) -> None:
        write_png(self._folder / f"{name}-capture.png", sight.shot)
        for kind, light in (("shown", sight.shown), ("blocks", sight.blocks)):
            if light is not None:
                write_png(self._folder / f"{name}-{kind}.png", _srgb(light))

    def _shrink(self) -> None:
        """Remove the oldest pictures beyond the limit."""
        files = sorted(self._folder.glob("*-*-*.png"))
        sizes = np.cumsum([path.stat().st_size for path in files[::-1]])[::-1]
        for path, size in zip(files, sizes, strict=True):
            if size > self._most:
                path.unlink()

    def _tell(self, line: dict[str, object]) -> None:
        path = self._folder / STATES
        if path.exists() and path.stat().st_size > MOST_LINES:
            path.replace(self._folder / OLDER)
        with path.open("ab") as file:
            file.write(encode(line))


def report(folder: Path) -> Iterator[str]:
    """Yield a line per change of state or reason: time, state, correction, reason, and the names of its pictures."""
    files = [path for path in (folder / OLDER, folder / STATES) if path.exists()]
    if not files:
        raise InputError(f"{folder}: no {STATES}; name the folder of counterlight play --watch-record")
    before = None
    for line in (line for path in files for line in path.read_bytes().splitlines()):
        try:
            each = json.loads(line)
        except ValueError:  # a line that a power cut has cut
            continue
        said = each["state"], each["reason"]
        if said == before and not each["pictures"]:
            continue
        before = said
        when = time.strftime("%d %b %H:%M:%S", time.localtime(each["time"]))
        cells = when, f"{each['state']:14}", f"{each['captures']:6} captures", each["reason"], each["pictures"]
        yield "  ".join(cells).rstrip()


def _srgb(light: FloatArray) -> np.ndarray:
    height, width = light.shape[:2]
    return encoded(np.clip(light, 0, 1), Response("srgb").over((height, width)))
