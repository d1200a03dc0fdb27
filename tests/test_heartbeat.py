"""The heartbeat: messages to a log, a service manager and a supervisor; none of them can stop a show."""

import json
import os
import socket
import threading
from pathlib import Path

import pytest

from counterlight.errors import InputError
from counterlight.unattended import heartbeat
from counterlight.unattended.heartbeat import FACTS, Heartbeat, Inbox, Notifier, read_facts
from tests.stage import Clock


@pytest.fixture
def clock() -> Clock:
    return Clock()


def received(inbox: socket.socket) -> dict[str, str]:
    return dict(line.split("=", 1) for line in inbox.recv(1 << 16).decode().splitlines())


def test_a_line_a_second_with_the_frames_since_the_last(tmp_path: Path, clock: Clock) -> None:
    heart = Heartbeat(tmp_path / "log", Notifier(None), clock=clock)
    for frames in range(0, 101):
        heart.beat({"frames": frames, "gap": float("inf"), "path": "a\nb"})
        clock.now += 0.04
    heart.close()
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [line["frames"] for line in lines] == [0, 25, 50, 75, 100]
    assert [line.get("fps") for line in lines] == [None, 25, 25, 25, 25]
    assert {line["pid"] for line in lines} == {os.getpid()}
    assert all(line["gap"] is None and line["path"] == "a\nb" and line["rss_bytes"] > 1 << 20 for line in lines)


def test_the_service_manager_hears_it(tmp_path: Path, manager: socket.socket, clock: Clock) -> None:
    heart = Heartbeat(None, Notifier(str(tmp_path / "notify")), clock=clock)
    heart.beat({"path": "a\nREADY=0", "time_pos": 2.5})
    heart.beat({"time_pos": 3.5})
    clock.now += 1
    heart.beat({"time_pos": 4.5})
    heart.close()
    first, second, last = (received(manager) for _ in range(3))
    assert first["READY"] == first["WATCHDOG"] == second["WATCHDOG"] == last["STOPPING"] == "1"
    assert "READY" not in second
    assert read_facts(first) == {"path": "a\nREADY=0", "time_pos": 2.5}
    assert read_facts(second) == {"time_pos": 4.5}
    heart = Heartbeat(None, Notifier(str(tmp_path / "notify")))
    heart.beat({"path": "\udcff\x1b"})  # a name that is not valid text
    assert received(manager)["STATUS"] == r"path \udcff\x1b"
    heart.close()
    assert read_facts({FACTS: "{"}) == read_facts({FACTS: "[]"}) == read_facts({}) == {}


def test_an_abstract_socket_and_one_that_is_not_there() -> None:
    name = f"counterlight-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inbox:
        inbox.bind("\0" + name)
        notifier = Notifier("@" + name)
        notifier.send(WATCHDOG="1")
        assert inbox.recv(100) == b"WATCHDOG=1"
    notifier.send(WATCHDOG="1")  # no receiver: no error
    notifier.close()


def test_a_log_is_bounded(tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heartbeat, "MAX_LOG_BYTES", 1000)
    heart = Heartbeat(tmp_path / "log", Notifier(None), clock=clock)
    for number in range(200):
        clock.now += 1
        heart.beat({"number": number})
    heart.close()
    assert {path.name for path in tmp_path.iterdir()} == {"log", "log.1"}
    assert all(path.stat().st_size < 1200 for path in tmp_path.iterdir())
    numbers = [
        json.loads(line)["number"] for name in ("log.1", "log") for line in (tmp_path / name).read_text().splitlines()
    ]
    assert numbers == list(range(200 - len(numbers), 200))


def test_a_reader_that_does_not_read_stops_nothing(tmp_path: Path, clock: Clock) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    heart = Heartbeat(tmp_path / "pipe", Notifier(None), clock=clock)
    for _ in range(2000):  # 64 KiB are full after about 700
        clock.now += 1
        heart.beat({})
    os.close(reader)
    clock.now += 1
    heart.beat({})  # a closed pipe causes no error either
    heart.close()
    with pytest.raises(InputError, match="no heartbeat can be written here"):
        Heartbeat(tmp_path / "no" / "log", Notifier(None))


def test_what_never_stops_talking_is_not_listened_to_for_ever() -> None:
    with Inbox() as inbox:
        notifier, stop = Notifier(f"fd:{os.dup(inbox.theirs)}"), threading.Event()

        def talk() -> None:
            while not stop.is_set():
                notifier.send(WATCHDOG="1")

        thread = threading.Thread(target=talk)
        thread.start()
        for _ in range(20):
            while not inbox.drain():
                pass
        stop.set()
        thread.join()
        inbox.handed_over()
        notifier.close()
        while inbox.drain():
            pass
    assert not Notifier("fd:x").send(WATCHDOG="1")
    assert not Notifier("fd:999999").send(WATCHDOG="1")
