"""Random lines to the control socket of a show: bytes, damaged requests, known words in any order."""

import json
import subprocess
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tests.fuzz.memory import CLIPS, looping
from tests.fuzz.tally import CRASHED, HUNG, READ, Plan, Tally, Trial
from tests.player_page import properties
from tests.programs import PATIENCE_S, wait_until
from tests.remote import Client

OUTSTANDING = 100  # lines without an answer at most, so that neither side blocks
WORDS = (
    *("get_property", "set_property", "observe_property", "cycle", "add", "multiply", "set", "place", "seek"),
    *("loadfile", "place-move", "place-scale", "place-save", "show-text", "ab-loop", "frame-step", "reload"),
)
VALUES = (None, True, 0, -1, 1e308, 10**400, "", "\udc80", [], {}, [[0, 0]] * 4, "nan", "yes")
THINGS: tuple[object, ...] = (*properties(), *VALUES)


class Lines:
    """One client of a looping show. Each trial is a line, and all are judged together at the end."""

    name, count = "lines", 10_000
    purpose = "random lines by one client of the control socket; the show must answer all and go on"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        with looping(plan.scratch) as (process, client):
            try:
                lines = (random_line(plan.rng(self.name, index), index) for index in plan.indices())
                tally.verdicts[READ] += send_and_count(client, lines)
                assert_goes_on(client, process, next(iter(CLIPS)))
                client.ask("quit")
                _, errors = process.communicate(timeout=PATIENCE_S)
            except (AssertionError, OSError, subprocess.TimeoutExpired) as error:
                tally.add(plan.first, Trial(HUNG if process.poll() is None else CRASHED, repr(error)))
                return tally
        if process.returncode or faults_told(errors):
            tally.add(plan.first, Trial(CRASHED, f"exit code {process.returncode}: {errors}"))
        return tally


def random_line(
    rng: np.random.Generator, index: int, words: Sequence[str] = WORDS, things: Sequence[object] = THINGS
) -> bytes:
    """Return a random line, never blank and never `quit`. No random change of one letter produces `quit`."""
    if index % 3 == 0:
        return rng.bytes(int(rng.integers(1, 200))).replace(b"\n", b"") + b"."
    picked = [words[rng.integers(len(words))], *(things[i] for i in rng.integers(0, len(things), rng.integers(0, 4)))]
    line = json.dumps({"command": picked, "request_id": int(rng.integers(0, 9))}).encode()
    if index % 3 == 1:
        at = int(rng.integers(0, len(line)))
        line = line[:at] + rng.bytes(1).replace(b"\n", b"") + line[at + 1 :]
    return line


def send_and_count(client: Client, lines: Iterable[bytes]) -> int:
    """Send lines and wait for the answer to each; return their number."""
    sent = answered = 0
    for line in lines:
        client.send(line)
        sent += 1
        while sent - answered > OUTSTANDING:
            client.answer()
            answered += 1
    for _ in range(sent - answered):
        client.answer()
    return sent


def assert_goes_on(client: Client, process: Any, medium: str) -> None:
    """Undo everything that stops a show, and wait until the show displays frames of a medium."""
    for name, value in {"pause": False, "speed": 1, "blackout": False}.items():
        assert client.ask("set_property", name, value)["error"] == "success"
    client.ask("loadfile", medium)
    client.ask("set_property", "loop-file", True)
    frames = client.get("frames")
    wait_until(lambda: client.get("frames") > frames + 25, "the show goes on", process)


def faults_told(errors: str) -> list[str]:
    """Return the lines in which a player reports its own fault while answering a client."""
    return [line for line in errors.splitlines() if line.startswith("control: ")]
