"""--remote and --osc of a player in a window: allowed clients, their messages, and that no visitor harms the show."""

import base64
import json
import os
import signal
import socket
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from counterlight.remote.visitor import AT_ONCE
from counterlight.remote.web import LONGEST_MESSAGE, MOST_VISITORS
from tests.fuzz.lines import random_line
from tests.player_page import commands, properties
from tests.programs import PATIENCE_S, descendants, fail, on, wait_until
from tests.web_remote import Place, child, free_port, printed_address, show_with_remote


@pytest.mark.usefixtures("visitor")
def test_the_page_needs_no_token_and_says_nothing_and_everything_else_is_refused(
    shared_show: tuple[Any, Place],
) -> None:
    _, place = shared_show
    for path, kind in (("/", "text/html"), ("/remote.js", "text/javascript"), ("/remote.css", "text/css")):
        status, headers, body = place.get(path)
        assert status == 200
        assert headers["content-type"].startswith(kind)
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["referrer-policy"] == "no-referrer"
        assert place.token.encode() not in body
        assert b"://" not in body.replace(b"http://www.w3.org/", b"")  # nothing is loaded from elsewhere
    assert place.get("/../../etc/passwd")[0] == place.get("/remote.py")[0] == 404
    assert place.get("/", Host="evil.example")[0] == 421  # a foreign host name that points here
    assert place.get("/socket")[0] == 401
    for wrong, status in (
        ({"token": "x" * 22}, 401),
        ({"token": place.token[:-1]}, 401),
        ({"host": "evil.example"}, 421),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
    ):
        with pytest.raises(InvalidStatus) as refused:
            place.visit(**wrong)
        assert refused.value.response.status_code == status, wrong
    with place.visit(origin=f"http://127.0.0.1:{place.port}") as visitor:
        assert visitor.get("pause") is False


def test_what_a_visitor_asks_is_done_and_all_learn_what_changes(xvfb: str, small_room: Path, folder: Path) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place):
        with place.visit() as one, place.visit() as other:
            other.hear_until(lambda: "late-frames" in other.values)
            known = next(answered for answered in other.events if answered["event"] == "known")
            assert known["properties"]["brightness"]["min"] == -100
            assert known["properties"]["view"]["choices"][0] == "projector"
            assert set(known["commands"]) == set(commands())
            costly = {name for name, info in known["properties"].items() if info["costly"]}
            other.hear_until(lambda: set(other.values) == set(known["properties"]) - costly)
            assert one.ask("set_property", "brightness", 12)["error"] == "success"
            other.hear_until(lambda: other.values["brightness"] == 12)
            for words, says in (
                (["set_property", "brightness", 1000], "found 1000"),
                (["observe_property", 1, "pause"], "no such command"),
                (["unobserve_property", 1], "no such command"),
                (["fly"], "no such command"),
            ):
                assert says in one.ask(*words)["message"]
            one.send("{}")
            assert "expected" in one.answer(0)["message"]
            one.ask("seek", 1, "absolute")
            frames = other.values["frames"]
            other.hear_until(lambda: other.values["frames"] > frames + 5)
            assert one.ask("quit")["error"] == "success"
            other.hear_until(lambda: {"event": "shutdown"} in other.events)
            with pytest.raises(ConnectionClosed):
                other.hear_until(lambda: False)
        assert process.wait(PATIENCE_S) == 0


def test_pictures_of_the_screen_and_of_what_the_camera_will_see(xvfb: str, small_room: Path, folder: Path) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place), place.visit() as visitor:
        visitor.ask("set_property", "pause", True)
        visitor.ask("set_property", "test-card", "grid")

        def picture(name: str) -> np.ndarray:
            found: list[dict[str, str]] = []
            wait_until(lambda: bool(found.append(visitor.ask("preview", name, -1)["data"]) or found[-1]), name, process)
            data = np.frombuffer(base64.b64decode(found[-1]["jpeg"]), np.uint8)
            return cv2.imdecode(data, cv2.IMREAD_COLOR)

        assert picture("screen").shape == (28, 36, 3)
        assert picture("camera").shape == (30, 40, 3)
        assert "expected screen, camera" in visitor.ask("preview", "wall", -1)["message"]

        def rests() -> bool:
            """Whether no newer picture comes within one and a half seconds."""
            newest = visitor.ask("preview", "screen", -1)["data"]
            until_s = time.monotonic() + 1.5
            while newest is not None and time.monotonic() < until_s:
                time.sleep(0.3)  # longer than the interval between pictures
                if visitor.ask("preview", "screen", newest["serial"])["data"] is not None:
                    return False
            return newest is not None

        wait_until(rests, "a paused show draws nothing new", process)


@pytest.mark.usefixtures("visitor")
def test_twenty_visitors_and_slow_ones(shared_show: tuple[Any, Place]) -> None:
    """Twenty visitors request pictures and receive all changes. Five request and do not read.

    Show and others continue.
    """
    process, place = shared_show
    visitors = [place.visit() for _ in range(20)]
    slow = [SlowVisitor(place) for _ in range(5)]
    frames = visitors[0].get("frames")
    for _ in range(10):
        for each in slow:
            each.ask_for_much()
        for visitor in visitors:
            assert visitor.ask("preview", "camera", -1)["error"] == "success"
    wait_until(lambda: visitors[0].get("frames") > frames + 25, "the show goes on", process)
    visitors[3].ask("set_property", "contrast", 7)
    for visitor in visitors:
        visitor.hear_until(lambda visitor=visitor: visitor.values.get("contrast") == 7)  # type: ignore[misc]
    for visitor in visitors:
        visitor.close()
    assert (
        rss_mib(child(process.pid, "counterlight.remote")) < 100
    )  # unread data of slow visitors is not kept without limit
    for each in slow:
        each.close()


class SlowVisitor:
    """Requests the property list, 10 KB, again and again, and reads nothing."""

    def __init__(self, place: Place) -> None:
        self._socket = socket.create_connection(("127.0.0.1", place.port), PATIENCE_S)
        key = "dGhlIHNhbXBsZSBub25jZQ=="
        lines = "GET /socket HTTP/1.1", f"Host: 127.0.0.1:{place.port}", "Upgrade: websocket", "Connection: Upgrade"
        more = (
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Protocol: counterlight, {place.token}",
        )
        self._socket.sendall("\r\n".join([*lines, *more, "", ""]).encode())
        assert b"101" in self._socket.recv(20)
        self._socket.setblocking(False)

    def ask_for_much(self) -> None:
        request = json.dumps({"command": ["get_property", "property-info"]}).encode()
        frame = bytes([0x81, 0x80 | len(request), 0, 0, 0, 0]) + request  # masked with zeros: data unchanged
        try:
            for _ in range(200):
                self._socket.send(frame)
        except BlockingIOError:
            pass  # the server stops reading, which is the required behaviour

    def close(self) -> None:
        self._socket.close()


def rss_mib(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def test_more_than_there_is_room_for_are_sent_away(xvfb: str, small_room: Path, folder: Path) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place):
        visitors = [place.visit() for _ in range(MOST_VISITORS)]
        assert all(visitor.get("pause") is False for visitor in visitors)
        with pytest.raises(InvalidStatus) as refused:
            place.visit()
        assert refused.value.response.status_code == 503
        visitors.pop().close()
        wait_until(lambda: lets_in(place), "room for another", process)
        for visitor in visitors:
            visitor.close()


def lets_in(place: Place) -> bool:
    try:
        place.visit().close()
    except InvalidStatus:
        return False
    return True


def test_after_nonsense_it_answers_and_plays(
    xvfb: str, small_room: Path, folder: Path, rng: np.random.Generator
) -> None:
    """Known words in random order, damaged requests, bytes, invalid HTTP, and a message that is too long."""
    words = ["get_property", "set_property", "cycle", "add", "multiply", "set", "place", "seek", "place-drag"]
    words += ["loadfile", "place-move", "place-grab", "show-text", "ab-loop", "frame-step", "preview", "check-room"]
    things = [*properties(), None, True, 0, -1, 1e308, 10**400, "", "\udc80", [], {}, "nan"]
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place):
        with place.visit() as visitor:
            for index in range(int(2 * AT_ONCE)):  # above AT_ONCE, requests are read slowly
                line = random_line(rng, index, words, things)
                visitor.send(line.decode("latin-1") if index % 2 else line)
            answer = visitor.ask("set_property", "blackout", False)
            assert answer["error"] == "success", answer
        for nonsense in (b"\0" * 100, b"GET / HTTP/9.9\r\n\r\n", rng.bytes(5000), b"GET /" + b"a" * 100_000):
            with socket.create_connection(("127.0.0.1", place.port), PATIENCE_S) as stranger:
                try:
                    stranger.sendall(nonsense)
                    stranger.shutdown(socket.SHUT_WR)
                    while stranger.recv(1 << 16):
                        pass
                except OSError:
                    pass  # the server closed the connection first
        with place.visit() as visitor:
            visitor.send("x" * (LONGEST_MESSAGE + 1))
            with pytest.raises(ConnectionClosed):
                visitor.hear_until(lambda: False)
        with place.visit() as visitor:
            for name, value in {"pause": False, "speed": 1, "blackout": False}.items():
                assert visitor.ask("set_property", name, value)["error"] == "success"
            visitor.ask("loadfile", "clip.mkv")
            visitor.ask("set_property", "loop-file", True)
            frames = visitor.get("frames")
            wait_until(lambda: visitor.get("frames") > frames + 10, "the show goes on", process)
            visitor.ask("quit")
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert [line for line in errors.splitlines() if "Traceback" in line or "remote: its process" in line] == []


def test_a_remote_that_dies_is_replaced_and_the_show_does_not_notice(xvfb: str, small_room: Path, folder: Path) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place):
        with place.visit() as visitor:
            frames, first = visitor.get("frames"), child(process.pid, "counterlight.remote")
            os.kill(first, signal.SIGKILL)
            with pytest.raises(ConnectionClosed):
                visitor.hear_until(lambda: False)
        with place.visit() as visitor:  # tries until the server answers
            assert visitor.get("frames") >= frames
        assert child(process.pid, "counterlight.remote") != first
        process.terminate()
        assert process.wait(PATIENCE_S) == 130
        assert not descendants(process.pid)


def test_a_supervised_player_that_dies_comes_back_at_the_same_address(
    xvfb: str, small_room: Path, folder: Path
) -> None:
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop", "--supervise") as (process, place):
        os.kill(child(process.pid, "counterlight.app"), signal.SIGKILL)
        wait_until(lambda: plays(place), "the page of the next player", process)


def plays(place: Place) -> bool:
    """Return whether a living player is behind the page."""
    try:
        with place.visit() as visitor:
            return bool(visitor.ask("get_property", "frames")["data"])
    except (OSError, WebSocketException):
        return False


def test_osc_commands_the_show_and_is_answered(xvfb: str, small_room: Path, folder: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    with (
        show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop", "--osc", port) as (process, place),
        place.visit() as visitor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as desk,
    ):
        desk.connect(("127.0.0.1", port))
        desk.settimeout(PATIENCE_S)

        def send(address: str, *arguments: object) -> None:
            builder = OscMessageBuilder(address)
            for argument in arguments:
                builder.add_arg(argument)  # type: ignore[arg-type]
            desk.send(builder.build().dgram)

        def answer() -> tuple[str, list[object]]:
            message = OscMessage(desk.recv(2000))
            return message.address, list(message.params)

        send("/counterlight/set/brightness", 11.6)
        send("/counterlight/get/brightness")
        assert answer() == ("/counterlight/brightness", [12])
        send("/counterlight/share/contrast", 0.75)
        send("/counterlight/get/contrast")
        assert answer() == ("/counterlight/contrast", [50])
        send("/counterlight/set/pause", 1)
        send("/counterlight/get/pause")
        assert answer() == ("/counterlight/pause", [1])
        send("/counterlight/command/cycle", "pause")
        wait_until(lambda: visitor.get("pause") is False, "the show to go on", process)
        send("/counterlight/command/identify")
        assert answer()[0] == "/counterlight/command/identify"
        for address, arguments, says in (
            ("/counterlight/set/brightness", [1000], "found 1000"),
            ("/counterlight/set/brightness", [1, 2], "expected one value"),
            ("/counterlight/set/nose", [1], "no such property"),
            ("/counterlight/get/nose", [], "no such property"),
            ("/counterlight/command/fly", [], "no such command"),
            ("/counterlight/command/observe_property", [1, "pause"], "no such command"),
            ("/elsewhere", [], "expected /counterlight/"),
        ):
            send(address, *arguments)
            answered, (text,) = answer()
            assert answered == "/counterlight/error"
            assert says in str(text)
        for size in range(2000):
            desk.send(os.urandom(size % 200))
        desk.settimeout(0.2)

        def path_is_told() -> bool:  # data beyond the system's buffer is lost, and this request may be among them
            send("/counterlight/get/path")
            try:
                return answer() == ("/counterlight/path", ["clip.mkv"])
            except TimeoutError:
                return False

        wait_until(path_is_told, "an answer", process)
        send("/counterlight/command/quit")
        assert "remote: its process" not in process.communicate(timeout=PATIENCE_S)[1]


def test_where_the_page_is_is_printed_and_what_stands_in_the_way_is_one_line(
    xvfb: str, small_room: Path, folder: Path
) -> None:
    state = {"XDG_STATE_HOME": str(folder)}
    with show_with_remote(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, place):
        with place.visit() as visitor:
            visitor.ask("quit")
        answered = printed_address(process.communicate(timeout=PATIENCE_S)[0])
        assert answered is not None
        assert answered.groups() == (str(place.port), place.token)
    words = small_room, folder / "clip.mkv", "--no-config"
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        busy = taken.getsockname()[1]
        assert f"--remote 127.0.0.1:{busy}: Address already in use" in fail(
            "play", *words, "--remote", busy, **on(xvfb), **state
        )
    assert "argument --remote: expected HOST, PORT or HOST:PORT" in fail("play", "--remote", *words)
    assert "argument --osc: expected [HOST:]PORT" in fail("play", *words, "--osc", "localhost")
    (folder / "counterlight" / "remote-token").chmod(0o644)
    assert "only this user can read" in fail("play", *words, "--remote", free_port(), **on(xvfb), **state)
