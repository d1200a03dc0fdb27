"""Signals at random moments of commands that write and of a show whose clock of the day jumps.

SIGINT, SIGTERM and SIGHUP end a process within seconds, without a traceback. A process that was stopped for a while
continues. A kill leaves old or new outputs. `kill -9` of a show leaves no decoder.
"""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from counterlight.tools import build_correction_map
from tests import screens
from tests.faults import Run, Runner
from tests.fuzz.bench import ASKED, KILLED, NO_END, Bench, Blow
from tests.fuzz.tally import CRASHED, HANG_S, HUNG, LEFT, READ, Plan, Tally, Trial
from tests.media import numbered, write_video
from tests.programs import ROOT, descendants, is_running, on, verb
from tests.rooms import write_blurred_room
from tests.writing_commands import COMMANDS

ENDING = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
# exit codes of a process that was still starting Python
BEFORE_MAIN = tuple(-number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
START_S = 1.0  # seconds for the start of Python and a command's imports
STOPPED_S = 3.0  # seconds; longer than the player waits for the decoder
PATIENCE_S = 120.0
SHOWS = 4  # one trial in SHOWS is a show
JUMPS = """
import random, time
_now, _random = time.time, random.Random(1)
time.time = lambda: _now() + _random.uniform(-1e8, 1e8)
"""


class Signals:
    """A signal, perhaps two, between the start and shortly after the end."""

    name, count = "signals", 16
    purpose = "signals at random moments of commands and shows, clocks that jump"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        with Runner() as runner, screens.one_screen(plan.scratch) as display:
            bench = Bench(runner, plan.scratch)
            show = _Show(plan.scratch / "show", display)
            for index in plan.indices():
                rng = plan.rng(self.name, index)
                if index % SHOWS:
                    tally.add(index, _command(bench, rng, index))
                else:
                    tally.add(index, show.trial(rng))
        return tally


def _command(bench: Bench, rng: np.random.Generator, index: int) -> Trial:
    name = sorted(COMMANDS)[index // SHOWS % len(COMMANDS)]
    sent = _one((*ENDING, *ENDING, signal.SIGKILL, signal.SIGPIPE, signal.SIGSTOP), rng)
    after_s = float(rng.uniform(0, 1.1 * (bench.clean[name].seconds + START_S)))
    ends = {signal.SIGKILL: (KILLED, 0), signal.SIGPIPE: (0, 2, -signal.SIGPIPE), signal.SIGSTOP: (0,)}
    late_s: list[float] = []
    act = partial(_signalled, bench.program(name, bench.out), sent, after_s, late_s)
    blow = Blow(f"{sent.name} after {after_s:.2f} s", act, ends.get(sent, (0, ASKED, *BEFORE_MAIN)))
    return replace(bench.trial(name, blow), seconds=late_s[0] if sent in ENDING else 0.0, prompt=True)


def _signalled(program: Sequence[str], sent: signal.Signals, after_s: float, late_s: list[float], out: Path) -> Run:
    """Run a program, and send it a signal. late_s : receives the seconds from the signal to the end."""
    with tempfile.TemporaryFile("w+") as errors:
        process = _started(program, errors.fileno(), out.parent, {"PYTHONPATH": str(ROOT)})
        with suppress(subprocess.TimeoutExpired):
            process.wait(after_s)
        asked = time.monotonic()
        _send(process, sent)
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE_S)
        late_s.append(time.monotonic() - asked)
        code = NO_END if process.poll() is None else process.returncode
        _end(process)
        errors.seek(0)
        return Run(0, 0, code, _beyond_imports(code, errors.read()))


def _beyond_imports(code: int, said: str) -> str:
    """Return the output without a traceback of Ctrl-C during imports, because no work has begun."""
    ended = code in (-signal.SIGINT, ASKED) and said.rstrip().endswith("KeyboardInterrupt")
    return "" if ended and ", in <module>" in said and ", in main" not in said else said


class _Show:
    """A player in a window, alone or supervised. Its time of day is wrong."""

    def __init__(self, folder: Path, display: str) -> None:
        self._folder, self._display = folder, display
        (folder / "clock").mkdir(parents=True)
        (folder / "clock" / "sitecustomize.py").write_text(JUMPS)
        write_blurred_room(folder / "room", np.random.default_rng(7), (30, 40), (28, 36))
        assert build_correction_map.main([str(folder / "room"), "--regularize", "0.1"]) == 0
        write_video(folder / "clip.mkv", [numbered(i, 48, 64) for i in range(50)])

    def trial(self, rng: np.random.Generator) -> Trial:
        sent, after_s, supervised = (
            _one((*ENDING, signal.SIGKILL, signal.SIGSTOP), rng),
            rng.uniform(0, 5),
            rng.integers(3),
        )
        words = f"show{'' if supervised else ', supervised'}, {sent.name} after {after_s:.2f} s"
        options = (
            "--no-config",
            "--no-audio",
            "--loop",
            "--control",
            "socket",
            "--heartbeat",
            "log",
            "--shader",
            "fragment",
        )
        more = ("--supervise",) if supervised else ()
        with tempfile.TemporaryFile("w+") as errors:
            program = [*verb("play"), "room", "clip.mkv", *options, *more]
            environment = on(self._display) | {"PYTHONPATH": str(self._folder / "clock")}
            process = _started(program, errors.fileno(), self._folder, environment)
            with suppress(subprocess.TimeoutExpired):
                process.wait(after_s)
            family = descendants(process.pid)
            begun = time.monotonic()
            _send(process, sent)
            complaint = self._goes_on(process) if sent == signal.SIGSTOP else ""
            if sent == signal.SIGSTOP:
                _send(process, signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
            seconds = time.monotonic() - begun
            code, late = process.poll(), [pid for pid in family if not _gone(pid)]
            _end(process)
            errors.seek(0)
            said = _beyond_imports(process.returncode, errors.read())
        seconds = 0.0 if sent == signal.SIGSTOP else seconds
        return _judged(words, code, said, complaint, late, sent, seconds, self._leftovers(sent))

    def _goes_on(self, process: subprocess.Popen[bytes]) -> str:
        """Check that beats return after the player was stopped."""
        log, deadline = self._folder / "log", time.monotonic() + PATIENCE_S
        before = log.stat().st_size if log.exists() else 0
        while not log.exists() or log.stat().st_size <= before:
            if process.poll() is not None or time.monotonic() > deadline:
                return "no beat after it was continued"
            time.sleep(0.1)
        return ""

    def _leftovers(self, sent: signal.Signals) -> list[str]:
        """Remove leftover sockets and return their names; none after a kill, where the next player removes them."""
        found = [path for path in self._folder.iterdir() if path.name in ("socket",) or path.name.endswith(".new")]
        for path in found:
            path.unlink()
        return [] if sent == signal.SIGKILL else [path.name for path in found]


def _judged(
    words: str,
    code: int | None,
    said: str,
    complaint: str,
    late: Sequence[int],
    sent: signal.Signals,
    seconds: float,
    left: Sequence[str],
) -> Trial:
    ends = (KILLED,) if sent == signal.SIGKILL else (0, ASKED, *BEFORE_MAIN)
    if code is None or complaint:
        return Trial(HUNG, f"{words}: {complaint} {said[-1500:]}", seconds)
    if code not in ends or "Traceback" in said:
        return Trial(CRASHED, f"{words}: ended with {code}: {said[-1500:]}", seconds)
    if late or left:
        return Trial(LEFT, f"{words}: processes {list(late)}, files {list(left)}", seconds)
    return Trial(READ, words, seconds)


def _started(
    words: Sequence[str], errors: int, folder: Path | None = None, environment: dict[str, str] | None = None
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        words,
        cwd=folder,
        env=os.environ | (environment or {}),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        start_new_session=True,
        preexec_fn=_hears_all,
    )


def _hears_all() -> None:
    """Restore the default signals: background processes of a script and their children ignore Ctrl-C."""
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)


def _send(process: subprocess.Popen[bytes], sent: signal.Signals) -> None:
    if process.poll() is None:
        process.send_signal(sent)
        if sent == signal.SIGSTOP:
            time.sleep(STOPPED_S)
            process.send_signal(signal.SIGCONT)


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _gone(pid: int) -> bool:
    """Wait a few seconds until the processes are gone. Decoders notice that their parent has died."""
    deadline = time.monotonic() + HANG_S
    while is_running(pid):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


def _one(things: Sequence[signal.Signals], rng: np.random.Generator) -> signal.Signals:
    return things[rng.integers(len(things))]
