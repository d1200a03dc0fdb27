"""Twenty clients of the control socket at once, each with random commands, half lines, floods and sudden ends.

The show plays files and a live stream that loses one packet in fifty. The show must continue with a heartbeat every
second, JSON answers and bounded memory. It reports no fault on stderr, and leaves nothing behind.
"""

import json
import socket
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.tools import build_correction_map
from tests import screens
from tests.fuzz.heart import Heart
from tests.fuzz.names import Ground, draw_name
from tests.fuzz.tally import CRASHED, HUNG, LEFT, READ, REFUSED, WRONG, Plan, Tally, Trial
from tests.media import numbered, write_video
from tests.programs import descendants, on, running, verb
from tests.remote import Client
from tests.rooms import write_blurred_room
from tests.test_live import Sender, udp_port

CLIENTS, LOSS = 20, 0.02
LATEST_S = 2.0  # largest allowed delay of a heartbeat
INTERVAL_S = 1.0
PATIENCE_S = 60.0
PAUSE_S = 0.03  # seconds between requests that wait for their answers
FLOOD = 500  # lines that are sent without waiting for answers
# commands that are not drawn, because they would end the show or change the room
NOT_SAID = {"quit", "loop-playlist", "place-save"}
PLAYING = ("pause", False), ("speed", 1), ("blackout", False)  # settings that are reset, so that the show continues
VALUES: tuple[object, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        2,
        0.5,
        99,
        1e308,
        -1e308,
        10**400,
        "",
        "yes",
        "no",
        "nan",
        "inf",
        "\udc80",
        "\0",
        [],
        {},
    ),
    *(
        [[0, 0]] * 4,
        "camera",
        "projector",
        "absolute",
        "append",
        "replace",
        "relative",
        "x" * 3000,
        {"a": [1]},
        "1e400",
    ),
)


class Remotes:
    """Each trial is a request. The seed determines each client's requests, but not their order among clients."""

    name, count = "remotes", 6000
    purpose = "random commands of 20 clients while packets of a live stream are lost"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        with screens.one_screen(plan.scratch) as display, _show(plan.scratch, display) as show:
            clients = [_Rowdy(show, plan, number) for number in range(CLIENTS)]
            for client in clients:
                client.start()
            while any(client.is_alive() for client in clients) and show.process.poll() is None:
                show.look()
                time.sleep(0.2)
            show.over.set()
            for client in clients:
                client.join(PATIENCE_S)
            for client in clients:
                for verdict, count in client.answers.items():
                    tally.verdicts[verdict] += count
            found = [Trial(WRONG, words) for client in clients for words in client.complaints[:1]] + show.ended()
        for index, trial in enumerate(found):
            tally.add(index, trial, {"errors": (plan.scratch / "errors").read_bytes()})
        tally.peak, tally.slowest_s = show.heart.grown, show.heart.longest_s
        tally.notes |= {"connections": sum(client.connections for client in clients), "frames": show.heart.frames}
        tally.notes["minutes"] = round(show.minutes, 1)
        return tally


class _Show:
    """A player and its heartbeats so far."""

    def __init__(self, process: subprocess.Popen[str], folder: Path, media: Sequence[str], ground: Ground) -> None:
        self.process, self.folder, self.media, self.ground = process, folder, media, ground
        self.control = folder / "show.socket"
        self.over = threading.Event()
        self.heart = Heart(folder / "show.log")
        self._begun = time.monotonic()
        self.minutes = 0.0
        with Client(self.control) as client:
            self.commands = [entry["name"] for entry in client.get("command-list") if entry["name"] not in NOT_SAID]
            self.properties = [name for name in client.get("property-list") if name not in NOT_SAID]

    def look(self) -> None:
        """Read the beats since the last look."""
        self.minutes = (time.monotonic() - self._begun) / 60
        self.heart.look()

    def ended(self) -> list[Trial]:
        """End the show as its user would; return its faults and leftovers."""
        if self.process.poll() is not None:
            return [Trial(CRASHED, f"the show ended with {self.process.returncode}: {self._said()}")]
        longest_s = self.heart.longest_s
        found = [Trial(HUNG, f"{longest_s:.1f} s between beats")] if longest_s > INTERVAL_S + LATEST_S else []
        children = descendants(self.process.pid)
        try:
            with Client(self.control) as client:
                for name, value in PLAYING:
                    client.ask("set_property", name, value)
                client.ask("loadfile", self.media[0])
                _until(lambda: client.get("path") == self.media[0], "the medium")
                before = client.get("frames")
                _until(lambda: client.get("frames") > before + 20, "the show goes on")
                client.ask("quit")
            code = self.process.wait(PATIENCE_S)
        except (OSError, AssertionError, subprocess.TimeoutExpired) as error:
            return [*found, Trial(HUNG, f"{error!r}: {self._said()}")]
        if code != 0 or "Traceback" in self._said() or "\ncontrol: " in self._said():
            found.append(Trial(CRASHED, f"exit code {code}: {self._said()}"))
        left = [str(pid) for pid in children if Path(f"/proc/{pid}").exists()]
        left += [path.name for path in self.folder.iterdir() if path.name.endswith((".socket", ".new"))]
        return [*found, Trial(LEFT, ", ".join(left))] if left else found

    def _said(self) -> str:
        return (self.folder / "errors").read_text(errors="replace")[-2000:]


@contextmanager
def _show(folder: Path, display: str) -> Iterator[_Show]:
    ground = Ground(folder / "ground", "127.0.0.1:9")
    ground.lay()
    write_blurred_room(folder / "room", np.random.default_rng(7), (30, 40), (28, 36))
    assert build_correction_map.main([str(folder / "room"), "--regularize", "0.1"]) == 0
    clips = [str(folder / f"{n}.mkv") for n in range(2)]
    for clip, shape in zip(clips, [(48, 64), (96, 128)], strict=True):
        write_video(Path(clip), [numbered(i, *shape) for i in range(50)])
    (folder / "shots").mkdir()
    port = udp_port()
    live = f"udp://127.0.0.1:{port}"
    options = "--loop", "--no-config", "--no-audio", "--shader", "fragment", "--screenshot-directory", folder / "shots"
    message = "--control", folder / "show.socket", "--heartbeat", folder / "show.log"
    words = [*verb("play"), folder / "room", *clips, live, *options, *message]
    with (
        (folder / "errors").open("w") as errors,
        Sender(port, (320, 240), loss=LOSS),
        running(*words, folder=ground.media, errors=errors.fileno(), **on(display)) as process,
    ):
        _until((folder / "show.socket").exists, "the socket")
        yield _Show(process, folder, [*clips, live], ground)


class _Rowdy(threading.Thread):
    """A client that misbehaves."""

    def __init__(self, show: _Show, plan: Plan, number: int) -> None:
        super().__init__(daemon=True)
        self._show, self._plan, self._number = show, plan, number
        self._rng = plan.rng(Remotes.name, number)
        self._left = plan.count // CLIENTS
        self.answers: Counter[str] = Counter()
        self.complaints: list[str] = []
        self.connections = 0

    def run(self) -> None:
        while self._left > 0 and time.monotonic() < self._plan.until and not self._show.over.is_set():
            with suppress(OSError), socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(PATIENCE_S)
                connection.connect(str(self._show.control))
                self.connections += 1
                self._speak(
                    connection, [self._ask, self._ask, self._ask, self._flood, self._break_off][self._rng.integers(5)]
                )
            time.sleep(0.02)

    def _speak(self, connection: socket.socket, how: Callable[[socket.socket, Iterator[bytes]], None]) -> None:
        how(connection, iter(connection.makefile("rb")))

    def _ask(self, connection: socket.socket, lines: Iterator[bytes]) -> None:
        """Send one request after another, and wait for each answer."""
        for _ in range(self._rng.integers(1, 60)):
            connection.sendall(self._line() + b"\n")
            self._hear(lines)
            time.sleep(self._rng.exponential(PAUSE_S))

    def _flood(self, connection: socket.socket, lines: Iterator[bytes]) -> None:
        """Send requests without reading, then perhaps read all answers."""
        connection.settimeout(1.0)
        sent = 0
        with suppress(TimeoutError):
            for _ in range(FLOOD):
                connection.sendall(self._line() + b"\n")
                sent += 1
        connection.settimeout(PATIENCE_S)
        for _ in range(sent if self._rng.integers(2) else 0):
            self._hear(lines)

    def _break_off(self, connection: socket.socket, lines: Iterator[bytes]) -> None:
        """Send half a line or a very long line."""
        line = self._line()
        connection.sendall(line[: self._rng.integers(len(line) + 1)])
        if not self._rng.integers(8):
            connection.sendall(b"y" * (200 << 10))

    def _hear(self, lines: Iterator[bytes]) -> None:
        """Receive the next answer and skip events. A client beyond the limit receives nothing and is disconnected."""
        for line in lines:
            try:
                message = dict(json.loads(line))
            except (ValueError, TypeError):
                self.complaints.append(f"no JSON object: {line[:200]!r}")
                return
            if "error" in message:
                self.answers[READ if message["error"] == "success" else REFUSED] += 1
                return
            if "event" not in message:
                self.complaints.append(f"neither answer nor event: {line[:200]!r}")
        raise ConnectionError

    def _line(self) -> bytes:
        """Return random bytes, a damaged request, or a valid request from the player's own lists."""
        self._left -= 1
        rng = self._rng
        if not rng.integers(8):
            return rng.bytes(int(rng.integers(1, 200))).replace(b"\n", b"") + b"."
        line = json.dumps({"command": self._request(), "request_id": int(rng.integers(0, 9))}).encode()
        if not rng.integers(8):
            at = int(rng.integers(0, len(line)))
            line = line[:at] + rng.bytes(1).replace(b"\n", b"") + line[at + 1 :]
        return line

    def _request(self) -> list[Any]:
        rng, show = self._rng, self._show
        kind, few = rng.integers(6), [_one(VALUES, rng) for _ in range(rng.integers(0, 4))]
        if not rng.integers(12):
            return ["set_property", *_one(PLAYING, rng)]
        if not rng.integers(50):  # media need time to be shown
            return ["loadfile", self._medium(), *few[:1]]
        if kind <= 1:
            return ["set_property", _one(show.properties, rng), *few[:1]]
        if kind == 2:
            return [_one(("get_property", "get_property_string"), rng), _one(show.properties, rng)]
        if kind == 3:
            return [
                _one(("observe_property", "unobserve_property"), rng),
                int(rng.integers(99)),
                _one(show.properties, rng),
            ]
        if kind == 4:
            words = "cycle", "add", "multiply", "set", "enable_event", "disable_event", "client_name", "get_time_us"
            return [_one(words, rng), _one(show.properties, rng), *few]
        return [_one(show.commands, rng), *few]

    def _medium(self) -> str:
        if self._rng.integers(3):
            return str(_one(self._show.media, self._rng))
        name = draw_name(self._show.ground, self._rng, int(self._rng.integers(200)))
        if name.content is not None:
            (self._show.ground.media / name.text).write_bytes(name.content)
        return name.text


def _one(things: Sequence[Any], rng: np.random.Generator) -> Any:
    return things[rng.integers(len(things))]


def _until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
