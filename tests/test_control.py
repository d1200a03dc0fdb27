"""The control socket: answers to a client, and clients that cannot harm the show. The registry is small."""

import json
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from counterlight.show.client import MAX_LINE, MAX_OBSERVED, MAX_UNSENT, as_text
from counterlight.show.control import MAX_CLIENTS, ControlServer
from counterlight.unattended.json_lines import encode

ENOUGH_POLLS = 4000


class Lamp:
    """Registry of a few commands and properties."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {
            "brightness": 0,
            "pause": False,
            "gap": 0.25,
            "path": "a.mp4",
            "playlist-playing-pos": 0,
        }
        self.asked = 0

    def names(self) -> Mapping[str, str]:
        return {"add": "add to brightness", "break": "a fault of ours", "tell": "give a long text"}

    def usage(self, name: str) -> str:
        return {"add": "NUMBER", "break": "", "tell": "SIZE"}[name]

    def info(self, name: str) -> dict[str, Any]:
        return {"name": name, "type": "any", "writable": self.writable(name)}

    def properties(self) -> Mapping[str, str]:
        return dict.fromkeys(self.values, "")

    def writable(self, name: str) -> bool:
        return name in ("brightness", "pause")

    def run(self, name: str, *arguments: object) -> object:
        return {"add": self._add, "break": self._break, "tell": lambda size: "x" * size}[name](*arguments)

    def get(self, name: str) -> object:
        self.asked += 1
        return self.values[name]

    def set(self, name: str, value: object) -> None:
        if name == "brightness" and value not in range(-100, 101):
            raise ValueError(f"brightness: expected -100 to 100, found {value!r}")
        self.values[name] = value

    def _add(self, number: int) -> int:
        self.values["brightness"] += number
        return int(self.values["brightness"])

    def _break(self) -> None:
        raise KeyError("lamp")


class Client:
    """Blocking connection that polls the server while it waits for an answer."""

    def __init__(self, path: Path, serve: Callable[[], None]) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(path))
        self.socket.setblocking(False)
        self._serve, self._arrived = serve, b""

    def send(self, data: bytes) -> None:
        """Send all data, and serve the other end while its buffer is full."""
        for _ in range(ENOUGH_POLLS):
            try:
                data = data[self.socket.send(data) :]
            except BlockingIOError:
                self._serve()
            if not data:
                return
        raise AssertionError("the server does not read")

    def line(self) -> dict[str, Any]:
        for _ in range(ENOUGH_POLLS):
            line, newline, rest = self._arrived.partition(b"\n")
            if newline:
                self._arrived = rest
                return dict(json.loads(line))
            self._serve()
            try:
                piece = self.socket.recv(1 << 16)
                assert piece, "closed"
                self._arrived += piece
            except BlockingIOError:
                pass
        raise AssertionError("no answer")

    def ask(self, *words: object, number: int = 0) -> dict[str, Any]:
        self.send(encode({"command": list(words), "request_id": number}))
        return self.line()

    def silent(self) -> bool:
        for _ in range(3):
            self._serve()
        try:
            return not self.socket.recv(1)
        except BlockingIOError:
            return not self._arrived


@pytest.fixture
def lamp() -> Lamp:
    return Lamp()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ControlServer]:
    server = ControlServer(tmp_path / "socket")
    yield server
    server.close()
    assert not (tmp_path / "socket").exists()


@pytest.fixture
def connect(server: ControlServer, lamp: Lamp, tmp_path: Path) -> Iterator[Callable[[], Client]]:
    clients: list[Client] = []

    def open_one() -> Client:
        clients.append(Client(tmp_path / "socket", lambda: server.poll(lamp)))
        return clients[-1]

    yield open_one
    for client in clients:
        client.socket.close()


@pytest.fixture
def client(connect: Callable[[], Client]) -> Client:
    return connect()


def test_properties_and_commands_as_mpv_answers_them(client: Client, lamp: Lamp) -> None:
    assert client.ask("get_property", "gap", number=7) == {"request_id": 7, "error": "success", "data": 0.25}
    assert client.ask("set_property", "brightness", 12)["error"] == "success"
    assert client.ask("add", 3, number=-1) == {"request_id": -1, "error": "success", "data": 15}
    assert lamp.values["brightness"] == 15
    assert client.ask("get_property_string", "brightness")["data"] == "15"
    assert client.ask("get_property_string", "pause")["data"] == "no"
    assert client.ask("set_property_string", "pause", "yes")["error"] == "success"
    assert client.ask("client_name")["data"] == "ipc-1"
    assert client.ask("get_version")["data"] == 65536
    assert {entry["name"] for entry in client.ask("get_property", "command-list")["data"]} == set(lamp.names())
    assert client.ask("get_property", "command-list")["data"][0] == {
        "name": "add",
        "help": "add to brightness",
        "usage": "NUMBER",
    }
    assert client.ask("get_property", "property-list")["data"] == list(lamp.values)
    infos = client.ask("get_property", "property-info")["data"]
    assert [(each["name"], each["writable"]) for each in infos] == [(name, lamp.writable(name)) for name in lamp.values]


@pytest.mark.parametrize(
    ("line", "error", "says"),
    [
        (b'{"command": ["get_property", "nose"], "request_id": 3}', "property not found", "nose"),
        (b'{"command": ["get_property", ["gap"]]}', "property not found", "gap"),
        (b'{"command": ["get_property"]}', "invalid parameter", "0 arguments"),
        (b'{"command": ["set_property", "gap", 1]}', "error accessing property", "read only"),
        (b'{"command": ["set_property", "brightness", 1000]}', "error running command", "found 1000"),
        (b'{"command": ["fly"]}', "invalid parameter", "fly: no such command"),
        (b'{"command": ["add"]}', "invalid parameter", "not with these 0 arguments"),
        (b'{"command": ["break"]}', "error running command", "KeyError"),
        (b'{"command": ["observe_property", "one", "gap"]}', "invalid parameter", "a whole number"),
        (b'{"command": ["disable_event", "all of them"]}', "invalid parameter", "start-file"),
        (b'{"command": [1]}', "invalid parameter", "NAME"),
        (b'{"command": "quit", "request_id": 3}', "invalid parameter", "NAME"),
        (b"[1, 2]", "invalid parameter", "no JSON object"),
        (b"quit", "invalid parameter", "no JSON object"),
        (b"\xff\xfe", "invalid parameter", "no JSON object"),
        (b'{"command": [' + b"9" * 5000 + b"]}", "invalid parameter", "no JSON object"),
        (b"[" * 30_000, "invalid parameter", "no JSON object"),
        (b"x" * (3 * MAX_LINE), "invalid parameter", f"more than {MAX_LINE} bytes"),
    ],
)
def test_what_is_wrong_is_answered_and_the_next_line_works(
    client: Client, line: bytes, error: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    client.send(line + b"\n")
    answer = client.line()
    assert answer["error"] == error
    assert says in answer["message"]
    assert answer["request_id"] == (3 if b'"request_id": 3' in line else 0)
    assert client.ask("add", 1)["data"] == 1
    assert capsys.readouterr().err.count("\n") == (b"break" in line)  # faults of the product are also printed here


def test_observed_properties_are_reported_at_once_and_when_they_change(client: Client, lamp: Lamp) -> None:
    assert client.ask("observe_property", 5, "gap")["error"] == "success"
    assert client.line() == {"event": "property-change", "id": 5, "name": "gap", "data": 0.25}
    assert client.ask("observe_property_string", 6, "gap")["error"] == "success"
    assert client.line()["data"] == "0.250000"
    assert client.silent()
    lamp.values["gap"] = float("nan")
    assert [client.line()["data"] for _ in range(2)] == [None, "nan"]
    assert client.ask("unobserve_property", 5)["data"] == 1
    assert client.ask("unobserve_property", 5)["data"] == 0
    lamp.values["gap"] = 1.0
    assert client.line() == {"event": "property-change", "id": 6, "name": "gap", "data": "1.000000"}
    assert client.silent()


def test_the_next_file_is_reported_unless_it_is_not_wanted(connect: Callable[[], Client], lamp: Lamp) -> None:
    hears, deaf = connect(), connect()
    assert deaf.ask("disable_event", "start-file")["error"] == "success"
    assert hears.silent()
    lamp.values |= {"path": "b.mp4", "playlist-playing-pos": 1}
    assert hears.line() == {"event": "end-file"}
    assert hears.line() == {"event": "start-file", "path": "b.mp4"}
    assert deaf.line() == {"event": "end-file"}
    assert deaf.silent()


def test_closing_says_goodbye(lamp: Lamp, tmp_path: Path) -> None:
    server = ControlServer(tmp_path / "s")
    client = Client(tmp_path / "s", lambda: server.poll(lamp))
    assert client.ask("client_name")["error"] == "success"
    server.close()
    assert json.loads(client.socket.recv(1000)) == {"event": "shutdown"}
    assert client.socket.recv(1) == b""
    client.socket.close()


def test_a_client_that_does_not_read_costs_a_bounded_number_of_bytes(
    connect: Callable[[], Client], server: ControlServer, lamp: Lamp
) -> None:
    """The client requests more than the buffers hold, and observes a value that changes with every poll."""
    slow, quick = connect(), connect()
    assert slow.ask("observe_property", 1, "gap")["error"] == "success"
    request = encode({"command": ["tell", 10_000]})
    for index in range(2000):
        lamp.values["gap"] = float(index)
        try:
            slow.socket.send(request)
        except BlockingIOError:
            break
        server.poll(lamp)
    else:
        raise AssertionError("a client that reads nothing is read for ever")
    (kept,) = [peer for peer in server._clients._clients if peer._name == "ipc-1"]
    assert MAX_UNSENT <= len(kept._unsent) <= MAX_UNSENT + 10_100
    assert len(kept._arrived) <= MAX_LINE + (16 << 10)
    assert quick.ask("add", 1)["data"] == 1
    lamp.values["gap"] = -1.0
    while True:  # once the client reads, it gets its answers and the present value
        answer = slow.line()
        if answer.get("data") == -1.0:
            break


def test_many_clients_observations_and_hasty_leaves(
    connect: Callable[[], Client], server: ControlServer, lamp: Lamp
) -> None:
    clients = [connect() for _ in range(MAX_CLIENTS)]
    assert {client.ask("client_name")["data"] for client in clients} == {f"ipc-{i + 1}" for i in range(MAX_CLIENTS)}
    refused = connect()
    with pytest.raises(AssertionError, match="closed"):
        refused.line()
    for client in clients[1:]:
        client.send(b'{"command": ["get_property", "ga')
        client.socket.close()
    patient = clients[0]
    for number in range(MAX_OBSERVED + 1):
        patient.send(encode({"command": ["observe_property", number, "pause"]}))
    outcomes: list[str] = []
    while len(outcomes) <= MAX_OBSERVED:
        outcomes += [answer["error"] for answer in [patient.line()] if "error" in answer]
    assert outcomes == ["success"] * MAX_OBSERVED + ["invalid parameter"]
    assert len(server._clients) == 1
    assert connect().ask("client_name")["error"] == "success"


def test_each_observed_property_is_asked_for_once_a_poll(
    connect: Callable[[], Client], server: ControlServer, lamp: Lamp
) -> None:
    for client in (connect(), connect()):
        client.send(b"".join(encode({"command": ["observe_property", i, "gap"]}) for i in range(10)))
    for _ in range(10):
        server.poll(lamp)
    lamp.asked = 0
    server.poll(lamp)
    assert lamp.asked == 3  # the properties gap, path and playlist-pos were read


def test_ten_thousand_random_lines_and_it_still_answers(client: Client, lamp: Lamp, rng: np.random.Generator) -> None:
    """Bytes, mutilated requests and well-formed nonsense: every line that is not blank is answered."""
    words = [
        "get_property",
        "set_property",
        "observe_property",
        "add",
        "gap",
        "brightness",
        None,
        1e308,
        [],
        {},
        "\udc80",
    ]
    sent = answered = 0
    for index in range(10_000):
        if index % 3 == 0:
            line = rng.bytes(int(rng.integers(1, 200))).replace(b"\n", b"") + b"."
        else:
            picked = [words[i] for i in rng.integers(0, len(words), rng.integers(0, 5))]
            line = json.dumps({"command": picked, "request_id": int(rng.integers(0, 9))}).encode()
            if index % 3 == 1:
                at = int(rng.integers(0, len(line)))
                line = line[:at] + rng.bytes(1).replace(b"\n", b"") + line[at + 1 :]
        client.send(line + b"\n")
        sent += 1
        while answered < sent - 100:
            answered += "error" in client.line()
    while answered < sent:
        answered += "error" in client.line()
    lamp.values["brightness"] = 0
    while (answer := client.ask("add", 1, number=4711)).get("request_id") != 4711:
        assert "event" in answer
    assert answer == {"request_id": 4711, "error": "success", "data": 1}


def test_values_as_text() -> None:
    assert [as_text(value) for value in (True, 3, 0.5, "a", None, [1, 2])] == [
        "yes",
        "3",
        "0.500000",
        "a",
        "null",
        "[1, 2]",
    ]
