"""Hostile names in lists and over the socket, and films that name other files, in a real show with logged system calls.

The show may open nothing outside the border. It may write, run, call or listen to nothing that a harmless show does
not.
"""

import json
import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np

from counterlight.media.medium import Medium
from counterlight.show.playlist import is_list
from counterlight.tools import build_correction_map
from tests import screens
from tests.canaries import Canary, canary
from tests.fuzz.calls import Rules, calls_of, watched
from tests.fuzz.names import Ground, Name, draw_name
from tests.fuzz.tally import CRASHED, HUNG, READ, REFUSED, WRONG, Plan, Tally, Trial
from tests.programs import on, verb
from tests.remote import Client
from tests.rooms import write_blurred_room

TOGETHER = 20  # names per show
PATIENCE_S, LOOK_S = 120.0, 0.4
OPTIONS = "--no-config", "--no-audio", "--shader", "fragment", "--image-display-duration", "0.1"
HARMLESS = Name("clip.mkv"), Name("nope.mkv"), Name("harmless.mp4", b"no video" * 99), Name("list.m3u", b"clip.mkv\n")


class Lists:
    """Plays TOGETHER names per show: as the lines of a list, or by one `loadfile` command after another."""

    name, count = "lists", 120
    purpose = "hostile names in lists and over the socket, under a system-call watch"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        with canary() as bird, screens.one_screen(plan.scratch) as display:
            show = WatchedShow(plan.scratch, display, bird)
            left = plan.indices()
            while indices := list(islice(left, TOGETHER)):
                rngs = [plan.rng(self.name, index) for index in indices]
                names = [draw_name(show.ground, rng, index) for rng, index in zip(rngs, indices, strict=True)]
                self._judge(tally, show, indices, names, remote=bool(indices[0] // TOGETHER % 2))
        return tally

    def _judge(
        self, tally: Tally, show: "WatchedShow", indices: Sequence[int], names: Sequence[Name], *, remote: bool
    ) -> None:
        """Judge all names at once. After a fault, judge them one by one to find the name."""
        trial = show.trial(names, remote=remote)
        if trial.verdict in (READ, REFUSED):
            for index in indices:
                tally.add(index, Trial(REFUSED, "", trial.seconds / len(indices), trial.peak))
            return
        found = 0
        for index, name in zip(indices, names, strict=True):
            alone = show.trial([name], remote=remote)
            found += alone.verdict not in (READ, REFUSED)
            tally.add(index, alone, _files([name]))
        if not found:
            tally.add(indices[0], trial, _files(names))


class WatchedShow:
    """A watched player in a window. Its calls with harmless names define the allowed calls."""

    def __init__(self, scratch: Path, display: str, bird: Canary) -> None:
        self._scratch, self._display, self._bird = scratch, display, bird
        self.ground = Ground(scratch / "ground", f"127.0.0.1:{bird.port}")
        self.ground.lay()
        self._room = scratch / "room"
        write_blurred_room(self._room, np.random.default_rng(7), (30, 40), (28, 36))
        assert build_correction_map.main([str(self._room), "--regularize", "0.1"]) == 0
        (scratch / "tmp").mkdir()
        self._rules = Rules(frozenset(), (self.ground.media, self._room), scratch / "tmp")
        for remote in (False, True):
            self._tried(HARMLESS, remote=remote)
            self._rules = Rules(self._rules.known | calls_of(self._log), self._rules.roots, self._rules.scratch)
        bird.watch(self.ground.folder / "outside" / "secret.mkv")
        bird.touched()

    @property
    def _log(self) -> Path:
        return self._scratch / "calls"

    def trial(self, names: Sequence[Name], *, remote: bool) -> Trial:
        begun = time.monotonic()
        verdict, words = self._tried(names, remote=remote)
        seconds = min(time.monotonic() - begun, 1.0)  # in a show whose pictures are shown for at most a second
        if verdict in (CRASHED, HUNG):
            return Trial(verdict, words, seconds)
        broken = self._rules.broken_by(calls_of(self._log)) + sorted(self._bird.touched())
        if (self.ground.folder / "written").exists():
            broken.append("the file was written")
        return Trial(WRONG, f"{'remote' if remote else 'list'}: {broken[:20]}", seconds) if broken else Trial(REFUSED)

    def _tried(self, names: Sequence[Name], *, remote: bool) -> tuple[str, str]:
        for name in names:
            if name.content is not None:
                (self.ground.media / name.text).write_bytes(name.content)
        lines = [name.text for name in names if "\n" not in name.text and not is_list(Medium(name.text))]
        listed = "\n".join([*lines, "clip.mkv"]).encode("utf-8", "surrogateescape")
        (self.ground.media / "names.m3u").write_bytes(listed)
        control = self._scratch / "tmp" / "socket"
        media = ("clip.mkv", "--loop", "--control", control) if remote else ("names.m3u",)
        words = watched([*verb("play"), self._room, *media, *OPTIONS], self._log)
        quiet = {
            "PYTHONDONTWRITEBYTECODE": "1",
            "MESA_SHADER_CACHE_DISABLE": "true",
            "TMPDIR": str(self._scratch / "tmp"),
        }
        with (self._scratch / "errors").open("w+") as errors:
            process = subprocess.Popen(
                words,
                cwd=self.ground.media,
                env=os.environ | on(self._display) | quiet,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                text=True,
                start_new_session=True,
            )
            try:
                complaint = _spoken(process, control, names) if remote else ""
                code = process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                return HUNG, f"after {PATIENCE_S:g} s the show has not ended"
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, 9)
                process.wait()
            errors.seek(0)
            said = errors.read()
        if complaint or "Traceback" in said or code not in (0, 2):
            return CRASHED, f"exit code {code}: {complaint} {said[-1500:]}"
        return READ, ""


def _spoken(process: subprocess.Popen[str], control: Path, names: Sequence[Name]) -> str:
    """Load the names one after another into a show, then end the show; return the fault, or nothing."""
    until = time.monotonic() + PATIENCE_S
    while not control.exists():
        if process.poll() is not None or time.monotonic() > until:
            return "no socket"
        time.sleep(0.05)
    client = Client(control)
    try:
        for name in names:
            for how in ("replace", "append"):
                client.ask("loadfile", name.text, how)
            client.ask("playlist-next")
            time.sleep(LOOK_S)
        client.ask("quit")
    except (OSError, AssertionError, json.JSONDecodeError) as error:
        return repr(error)
    finally:
        client.close()
    return ""


def _files(names: Sequence[Name]) -> dict[str, bytes]:
    entries: Iterator[tuple[str, bytes]] = (
        (f"{i}.name", name.text.encode("utf-8", "replace")) for i, name in enumerate(names)
    )
    return dict(entries) | {name.text: name.content for name in names if name.content is not None}
