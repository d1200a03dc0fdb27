"""python -m counterlight.tools.watching [DIR]: the process that `counterlight play --watch` starts.

With a folder of `--watch-record`, prints what the watcher decided, and when. Otherwise reads messages from standard
input, and writes answers to standard output (counterlight.unattended.watch_link). Ends with its input. A camera that
fails is opened again and again.
"""

import argparse
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from counterlight import calibration
from counterlight.command import run
from counterlight.errors import InputError, one_line
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.watching.cameras import WatchCamera, open_cameras
from counterlight.tools.watching.record import Record, report
from counterlight.tools.watching.view import RoomView
from counterlight.tools.watching.watcher import Sight, Watcher
from counterlight.unattended.watch_link import GAINS, PAINT, Answer, Light, Message, Picture, Situation, Start, Unpacker

ANSWER_S, RETRY_S, GONE_S = 0.5, 5.0, 0.1
READ_BYTES = 1 << 20
NICE = 10  # the player's frames come first
STDIN, STDOUT = 0, 1  # not sys.stdout, which exr.py replaces while another thread reads the room


def tell(words: Sequence[str] | None) -> None:
    """Print what is recorded in a folder."""
    parser = argparse.ArgumentParser("python -m counterlight.tools.watching", description="Print a watched evening.")
    parser.add_argument("folder", type=Path, metavar="DIR", help="folder of counterlight play --watch-record")
    print(*report(parser.parse_args(words).folder), sep="\n")


def main() -> int:
    os.nice(NICE)
    messages = _messages()
    start = next(messages, None)
    if start is None:
        return 0
    if not isinstance(start, Start):
        raise InputError(f"the first message is {type(start).__name__}, expected Start")
    threading.excepthook = _end
    process = _Process(start)
    for target in (process.answer, process.look):
        threading.Thread(target=target, daemon=True).start()
    for message in messages:
        process.take(message)
    return 0


def _end(failed: threading.ExceptHookArgs) -> None:
    """End the process with any thread. The player reports the last line, and starts another watcher."""
    sys.excepthook(failed.exc_type, failed.exc_value or failed.exc_type(), failed.exc_traceback)
    os._exit(1)


class _Process:
    """The watcher between three threads: messages, captures and answers. `_lock` guards the watcher."""

    def __init__(self, start: Start) -> None:
        self._start, self._lock = start, threading.Lock()
        self._watcher: Watcher | None = None
        self._camera: WatchCamera | None = None
        self._trouble = self._unkept = ""
        self._number = 0  # of the row gains in the file
        self._record = Record(Path(start.record)) if start.record else None

    def take(self, message: Message) -> None:
        camera = self._camera
        with self._lock:
            watcher = self._watcher
            if watcher is None:
                return
            if isinstance(message, Light):
                watcher.light(message)
            elif isinstance(message, Situation):
                watcher.situation(message)
            elif isinstance(message, Picture):
                watcher.picture(message)
        if isinstance(message, Picture) and camera is not None:
            camera.show(message)

    def look(self) -> None:
        """Read the room, then take captures, and open the camera again after a failure."""
        stored = calibration.read(Path(self._start.calibration))
        view = RoomView(tier_of(stored.calibration, read_transport(stored), self._start.colour), self._start.factor)
        np.save(Path(self._start.folder) / PAINT, view.paint)
        while True:
            try:
                with open_cameras(self._start, stored.calibration) as camera:
                    self._see(view, camera)
            except InputError as error:
                self._trouble, self._camera = one_line(error), None
                time.sleep(RETRY_S)
            except FileNotFoundError:  # another program has removed a photograph before it was read
                self._camera = None
                time.sleep(GONE_S)

    def answer(self) -> None:
        """Write an answer every ANSWER_S, while the room is read less often."""
        while True:
            line = self.newest().line()
            with suppress(BrokenPipeError):
                os.write(STDOUT, line)
            time.sleep(ANSWER_S)

    def newest(self) -> Answer:
        """Return the answer of this moment. New row gains are in their file."""
        with self._lock:
            watcher = self._watcher
            answer = watcher.answer(time.monotonic()) if watcher is not None else Answer("starting")
            gains = watcher.row_gains() if watcher is not None and answer.row_gains != self._number else None
        if gains is not None:
            self._number, folder = answer.row_gains, Path(self._start.folder)
            np.save(new := folder / f"new-{GAINS}", gains)
            new.replace(folder / GAINS)  # the player never reads half a file
        if self._trouble:
            answer = replace(
                answer, state="no camera", reason=self._trouble, confidence=0.0, latency_s=0.0, rejected={}
            )
        return self._keep(answer)

    def _keep(self, answer: Answer) -> Answer:
        """Record an answer; returns the answer, with the reason why nothing can be recorded any more."""
        if self._record is not None:
            try:
                self._record.keep(time.time(), answer, self._sight)
            except OSError as error:
                self._record, self._unkept = None, f"--watch-record: {error}"
        reason = "; ".join(each for each in (answer.reason, self._unkept) if each)
        return replace(answer, reason=reason)

    def _sight(self) -> Sight | None:
        with self._lock:
            return self._watcher.sight() if self._watcher is not None else None

    def _see(self, view: RoomView, camera: WatchCamera) -> None:
        with self._lock:
            if self._watcher is None:
                learned = Path(self._start.folder) / GAINS
                self._watcher = Watcher(
                    view,
                    camera.exposure_s,
                    self._start.refresh_s,
                    follows=camera.follows,
                    row_gains=np.load(learned) if learned.exists() else None,
                )
            watcher = self._watcher
        self._camera = camera
        while True:
            with self._lock:
                watcher.waits(time.monotonic())
            arrived_s = camera.arrival()
            with self._lock:
                watcher.arrived(arrived_s)
                wants = camera.follows or watcher.wants(arrived_s)
            if wants:
                shot = camera.shot()
                with self._lock:
                    watcher.capture(arrived_s, shot, camera.exposures)
            self._trouble = ""


def _messages() -> Iterator[Message]:
    """Yield the messages of standard input until it ends."""
    unpacker = Unpacker()
    while content := os.read(STDIN, READ_BYTES):
        yield from unpacker.feed(content)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        sys.exit(run(tell))
    os._exit(main())  # a usual exit aborted once in 60 times, while other threads computed
