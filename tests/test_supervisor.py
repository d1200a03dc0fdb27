"""The supervisor: real players that are killed, stopped and asked to end, and the processes that remain."""

import configparser
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime, timedelta
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from counterlight.unattended import heartbeat
from counterlight.unattended.supervisor import (
    BACK_OFF_S,
    ENDING_S,
    LONGEST_BACK_OFF_S,
    MOST_CRASHES,
    START_S,
    WINDOW_S,
    Crashes,
    Place,
    with_options,
)
from tests import screens
from tests.desktop import mapped_windows
from tests.media import RATE, numbered, write_video
from tests.pjlink_projector import OFF, ON, projector
from tests.programs import (
    PATIENCE_S,
    children,
    descendants,
    fail,
    here,
    is_running,
    on,
    running,
    succeed,
    verb,
    wait_until,
)
from tests.rooms import write_blurred_room
from tests.stage import Clock
from tests.test_heartbeat import received


def test_back_off_doubles_up_to_its_limit_and_crashes_are_forgiven() -> None:
    crashes = Crashes(clock := Clock())
    waits = []
    for number in range(8):
        waits.append(crashes.add())
        assert crashes.too_many == (number + 1 >= MOST_CRASHES)
    assert waits == [min(BACK_OFF_S * 2 ** min(n, MOST_CRASHES - 1), LONGEST_BACK_OFF_S) for n in range(8)]
    clock.now += WINDOW_S + 1
    assert not crashes.too_many
    assert crashes.add() == BACK_OFF_S


def test_a_show_goes_on_where_it_was_unless_that_crashes_again() -> None:
    place = Place()
    assert place.options() == []
    place.follow({"time_pos": 12.5, "playlist_pos": 3})
    assert place.options() == ["--playlist-start=3", "--start=12.500"]
    place.follow({"time_pos": 13.0, "playlist_pos": 3})
    assert place.options() == ["--playlist-start=3", "--start=0.000"]
    place.follow({"time_pos": 30.0, "playlist_pos": 3})
    assert place.options() == ["--playlist-start=3", "--start=30.000"]
    place.follow({"time_pos": 0.2, "playlist_pos": 4})
    assert place.options() == ["--playlist-start=4", "--start=0.200"]
    place.follow({"time_pos": "?", "playlist_pos": None})
    assert place.item == 4


def test_options_are_added_before_names_that_look_like_some() -> None:
    assert with_options(["a", "--", "-b"], "--x") == ["a", "--x", "--", "-b"]
    assert with_options(["a", "--y"], "--x") == ["a", "--y", "--x"]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("supervised") / "wall"
    write_blurred_room(folder, np.random.default_rng(7), (30, 40), (24, 32))
    here("build", folder, "--regularize", "0.1")
    return folder


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film of five seconds whose frames cost next to nothing to decode."""
    return write_video(tmp_path_factory.mktemp("film") / "film.mkv", [numbered(n % 20) for n in range(5 * RATE)])


class Show:
    """A supervised player, its messages to the service manager, and its log."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process, self._log = process, log

    def beats(self) -> list[dict[str, Any]]:
        lines = self._log.read_text().splitlines(keepends=True) if self._log.exists() else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def player(self, *, other_than: int = 0, frames: int = 1) -> int:
        """Return the process id of the player, once a player other than `other_than` has shown some frames."""

        def shown() -> bool:
            beats = self.beats()
            return bool(beats) and beats[-1]["pid"] != other_than and beats[-1].get("frames", 0) >= frames

        self.wait(shown, "a player plays")
        return int(self.beats()[-1]["pid"])

    def crash(self, times: int) -> int:
        """Kill each player as soon as it exists; return the last player's process id."""
        killed = {0}
        for _ in range(times):
            self.wait(lambda: bool(children(self.process.pid) - killed), "a player starts")
            (pid,) = children(self.process.pid) - killed
            killed.add(pid)
            os.kill(pid, signal.SIGKILL)
        return pid

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        wait_until(condition, what, self.process)

    def is_black(self) -> bool:
        """Return whether the curtain, the program that shows only black, runs."""
        commands = [Path(f"/proc/{child}/cmdline") for child in descendants(self.process.pid)]
        with contextlib.suppress(OSError):
            return any(b"counterlight.gl.curtain" in command.read_bytes() for command in commands)
        return False

    def ended(self) -> tuple[int, str]:
        _, errors = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, errors


@contextmanager
def supervised(display: str, folder: Path, *arguments: object) -> Iterator[Show]:
    words = *verb("play"), *arguments, "--supervise", "--heartbeat", folder / "log"
    with running(*words, NOTIFY_SOCKET=str(folder / "notify"), **on(display)) as process:
        try:
            yield Show(process, folder / "log")
        finally:
            left = descendants(process.pid)
            process.kill()
            for pid in left:  # left only if the test has failed: they should end by themselves
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


def test_a_player_that_dies_or_hangs_is_replaced_where_it_was(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    """The player is killed, then stopped together with its decoder, then the supervisor is asked to end."""
    with supervised(xvfb, tmp_path, room, film, "--loop", "--start", "1") as show:
        first = show.player(frames=30)
        show.wait(lambda: "READY" in received(manager), "the service manager hears that there is a picture")
        os.kill(first, signal.SIGSEGV)
        show.wait(lambda: bool(descendants(show.process.pid) - {first}) and not is_running(first), "a new player")
        second = show.player(other_than=first)
        resumed = next(beat for beat in show.beats() if beat["pid"] == second)
        last = [beat for beat in show.beats() if beat["pid"] == first][-1]
        assert resumed["time_pos"] == pytest.approx(last["time_pos"], abs=1.5)  # a heartbeat per second
        everything = descendants(second) | {second}
        for pid in everything:
            os.kill(pid, signal.SIGSTOP)
        show.wait(lambda: not any(map(is_running, everything)), "what hangs is ended")
        show.wait(lambda: bool(descendants(show.process.pid)), "a third player is started")
        third = show.player(other_than=second)
        alive = descendants(show.process.pid)
        assert third in alive
        show.process.send_signal(signal.SIGTERM)
        code, errors = show.ended()
        assert code == 130
        assert not any(map(is_running, alive))
    assert "signal 11" in errors
    assert "the player hangs: ended" in errors


def test_a_screen_that_goes_and_comes_back(room: Path, film: Path, tmp_path: Path, manager: socket.socket) -> None:
    """The player reports the missing screen in one line. The supervisor restarts it until a screen is there."""
    with ExitStack() as first:
        display = first.enter_context(screens.one_screen(tmp_path, display=screens.reserved_display()))
        with supervised(display, tmp_path, room, film, "--loop", "--control", tmp_path / "socket") as show:
            pid = show.player()
            first.close()
            show.wait(lambda: not is_running(pid), "the player ends")
            with screens.one_screen(tmp_path, display=display):
                show.player(other_than=pid)
                show.process.send_signal(signal.SIGTERM)
                code, errors = show.ended()
    assert code == 130
    assert "error: the screen has gone, the X server ended" in errors
    assert "XIO" not in errors
    assert "ended with exit code 2 at item 0" in errors
    assert not (tmp_path / "socket").exists()


def test_nothing_is_left_of_a_supervisor_that_is_killed_and_strangers_have_nowhere_to_talk_to(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with supervised(xvfb, tmp_path, room, film, "--loop") as show:
        pid = show.player()
        sockets = {link.name: os.readlink(link) for link in Path(f"/proc/{show.process.pid}/fd").iterdir()}
        inodes = {name[8:-1] for name in sockets.values() if name.startswith("socket:")}
        assert len(inodes) == 2  # the supervisor's inbox, and its socket to the service manager
        table = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()]
        assert [line[7:] for line in table if line[6] in inodes] == [[], []]
        os.kill(pid, signal.SIGKILL)
        show.player(other_than=pid)
        show.wait(lambda: len(descendants(show.process.pid)) == 2, "only the player and its decoder")
        alive = descendants(show.process.pid)
        show.process.kill()
        _, errors = show.ended()
        deadline = time.monotonic() + PATIENCE_S
        while any(map(is_running, alive)) and time.monotonic() < deadline:
            time.sleep(0.05)
        outlived = [each for each in alive if is_running(each)]
        for each in outlived:
            os.kill(each, signal.SIGKILL)
        assert outlived == []
    assert "ended with signal 9 at item 0" in errors
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_show_goes_on_whoever_reads_its_lines(xvfb: str, room: Path, tmp_path: Path, manager: socket.socket) -> None:
    """Stderr has no reader, its pipe is full, and two thirds of the list fail. Then the reader closes the pipe."""
    (tmp_path / "broken.mkv").write_bytes(b"no video" * 100)
    clip = tmp_path / "clip.mkv"
    write_video(clip, [numbered(n) for n in range(3)])
    media = clip, tmp_path / ("x" * 200 + ".mkv"), tmp_path / "broken.mkv"
    readable, writable = os.pipe()
    with suppress(BlockingIOError):
        os.set_blocking(writable, False)
        while True:
            os.write(writable, bytes(4096))
    os.set_blocking(writable, True)
    words = *verb("play"), "--no-config", "--loop", "--heartbeat", tmp_path / "log", room, *media
    with running(*words, errors=writable, **on(xvfb)) as process:
        os.close(writable)
        show = Show(process, tmp_path / "log")
        show.player(frames=4)  # the list, which shows three frames, has started again
        os.close(readable)
        frames = show.beats()[-1]["frames"]
        show.wait(lambda: show.beats()[-1]["frames"] > frames + 3, "the show goes on")
        process.terminate()
        assert process.wait(PATIENCE_S) == 130


def test_a_player_whose_terminal_goes_ends_as_on_ctrl_c(xvfb: str, room: Path, film: Path, tmp_path: Path) -> None:
    words = *verb("play"), "--no-config", "--loop", "--heartbeat", tmp_path / "log"
    with running(*words, "--control", tmp_path / "socket", room, film, **on(xvfb)) as process:
        Show(process, tmp_path / "log").player()
        assert (tmp_path / "socket").is_socket()
        process.send_signal(signal.SIGHUP)
        assert process.wait(PATIENCE_S) == 130
    assert not (tmp_path / "socket").exists()


def test_after_five_crashes_the_screen_is_black_until_told_to_try_again(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    with supervised(xvfb, tmp_path, room, film, "--loop") as show:
        pid = show.crash(MOST_CRASHES)
        show.wait(show.is_black, "the safe picture")
        show.wait(lambda: (0, 0, 1280, 720) in mapped_windows(xvfb), "it fills the screen")
        show.process.send_signal(signal.SIGHUP)
        show.player(other_than=pid)
        assert not show.is_black()
        show.process.send_signal(signal.SIGINT)
        code, errors = show.ended()
    assert code == 130
    assert errors.count("signal 9") == MOST_CRASHES
    assert "going to the safe picture" in errors


def test_the_safe_picture_may_be_the_show_without_compensation(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    with supervised(xvfb, tmp_path, room, film, "--loop", "--safe", "plain") as show:
        pid = show.player(other_than=show.crash(MOST_CRASHES))
        assert b"--no-compensation" in Path(f"/proc/{pid}/cmdline").read_bytes()


def test_out_of_its_hours_a_show_is_black_and_projectors_are_off(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    """The hours change in the file while the show runs, so that no test waits for them."""
    today = datetime.now().date()
    closed = ", ".join(f'"{today + timedelta(days=n)}"' for n in range(-2, 3))
    with projector() as lamp:
        projectors = f'[[projectors]]\naddress = "127.0.0.1:{lamp.port}"\n'
        always = f'format = 1\n{projectors}[[hours]]\nfrom = "00:00"\nto = "00:00"\n'
        never = f"closed = [{closed}]\n{always}"
        hours = tmp_path / "hours.toml"

        def is_lamp(power: int) -> bool:
            """Query the lamp, which is warm or cool when it has been queried once. The keeper's next query is late."""
            return lamp.answer("POWR", "?") == str(power)

        def change(text: str) -> None:
            (tmp_path / "new").write_text(text)
            (tmp_path / "new").rename(hours)

        change(never)
        with supervised(xvfb, tmp_path, room, film, "--loop", "--schedule", hours) as show:
            show.wait(show.is_black, "black before the show")
            change(always)
            first = show.player(frames=10)
            show.wait(lambda: is_lamp(ON), "the projector is on")
            change(never)
            show.wait(show.is_black, "black behind the show")
            show.wait(lambda: is_lamp(OFF), "the projector is off")
            assert not is_running(first)
            change(always)
            second = show.player(other_than=first)
            begun = next(beat for beat in show.beats() if beat["pid"] == second)
            assert begun["time_pos"] < 1.5  # the list starts at its beginning
            show.process.send_signal(signal.SIGTERM)
            code, errors = show.ended()
    assert code == 130
    opens = f"{today + timedelta(days=3)} 00:00"
    assert errors.count(f"closed, by its schedule: black until the show begins, {opens}\n") == 1
    assert errors.count("the show begins, by its schedule") == 2
    assert errors.count(f"the show ends, by its schedule: black until the next show, {opens}\n") == 1
    assert "crash" not in errors


SUPERVISED = """
import sys
from pathlib import Path
from counterlight.unattended.heartbeat import Notifier
from counterlight.unattended.supervisor import Curtain, Supervisor
folder = Path(sys.argv[1])
player, curtain = ["sh", folder / "player"], Curtain(["sleep", "60"])
plays = lambda: not (folder / "closed").exists()
sys.exit(Supervisor([lambda resume: player], curtain, Notifier(None), plays, below=False).run())
"""
SLOW_TO_END = """
cd "$(dirname "$0")"
trap 'touch told; while [ ! -e go ]; do sleep 0.02; done; exit 130' TERM
echo >> started
while :; do sleep 0.02; done
"""


def test_hours_that_are_back_before_the_player_has_ended(tmp_path: Path) -> None:
    """The supervisor once mistook the end that it had requested for the end of the show."""
    (tmp_path / "player").write_text(SLOW_TO_END)
    started = tmp_path / "started"
    with running(sys.executable, "-c", SUPERVISED, tmp_path) as process:
        wait_until(started.exists, "a player", process)
        (tmp_path / "closed").touch()
        wait_until((tmp_path / "told").exists, "its hours have ended", process)
        (tmp_path / "closed").unlink()
        (tmp_path / "go").touch()
        wait_until(lambda: started.read_text().count("\n") == 2, "another player", process)
        process.terminate()
        assert process.wait(PATIENCE_S) == 130


def test_a_show_that_has_ended_waits_for_its_next_hours(
    xvfb: str, room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    hours = tmp_path / "hours.toml"
    hours.write_text('format = 1\n[[hours]]\nfrom = "00:00"\nto = "00:00"\n')
    with supervised(xvfb, tmp_path, room, film, "--start", "3", "--schedule", hours) as show:
        show.wait(show.is_black, "black behind the show")
        show.process.send_signal(signal.SIGHUP)
        first = show.beats()[0]["pid"]
        second = show.player(other_than=first)
        # the medium lasts five seconds
        assert min(beat["time_pos"] for beat in show.beats() if beat["pid"] == second) < 4.5
        show.process.send_signal(signal.SIGTERM)
        code, errors = show.ended()
    assert code == 130
    assert "the show has ended: black until its next hours" in errors


def test_a_medium_that_is_missing_is_waited_for(xvfb: str, room: Path, tmp_path: Path, manager: socket.socket) -> None:
    with supervised(xvfb, tmp_path, room, tmp_path / "late.mkv") as show:
        assert show.process.stderr is not None
        assert "late.mkv: no such file" in show.process.stderr.readline()
        show.wait(lambda: bool(show.beats()), "a beat")
        assert show.beats()[0]["path"] is None
        write_video(tmp_path / "new.mkv", [numbered(n) for n in range(20)])
        (tmp_path / "new.mkv").rename(tmp_path / "late.mkv")
        assert show.ended() == (0, "")  # a show that ends is not started again
    assert len({beat["pid"] for beat in show.beats()}) == 1


def test_a_disk_and_a_screen_that_come_late_are_waited_for(
    room: Path, film: Path, tmp_path: Path, manager: socket.socket
) -> None:
    """Each missing part is named once. No wait counts as a crash, and the service manager hears that the show lives."""
    display = screens.reserved_display()
    late = tmp_path / "disk" / "room"
    with supervised(display, tmp_path, late, film, "--loop", "--monitor", "0") as show:

        def waits_for(what: str) -> bool:
            beats = show.beats()
            return bool(beats) and what in beats[-1].get("waiting", "")

        show.wait(lambda: waits_for(f"{late}: no such folder"), "the disk is missing")
        show.wait(lambda: "READY" in received(manager), "the service manager hears that the show waits")
        shutil.copytree(room, tmp_path / "copy" / "room")
        (tmp_path / "copy").rename(tmp_path / "disk")
        show.wait(lambda: waits_for("no screen"), "the screen is missing")
        with screens.one_screen(tmp_path, display=display):
            pid = show.player(frames=1)
            assert {beat["pid"] for beat in show.beats()} == {pid}
            show.process.send_signal(signal.SIGTERM)
            code, errors = show.ended()
    assert code == 130
    assert errors.count("waiting: ") == 4  # two parts, and the end of each wait
    assert "crash" not in errors


def test_wrong_use_ends_it_with_one_line(xvfb: str, room: Path, film: Path, tmp_path: Path) -> None:
    assert "--frobnicate" in fail("play", "--supervise", room, film, "--frobnicate", **on(xvfb))
    names = "--monitor", "0", "--monitor", "0"
    assert "2 named, the calibration has 1 projector" in fail("play", "--supervise", room, film, *names, **on(xvfb))
    assert "leave out --output" in fail("play", "--supervise", room, film, "--output", tmp_path / "o.png")


def test_the_unit_starts_what_there_is_and_waits_longer_than_the_supervisor() -> None:
    unit = configparser.ConfigParser(strict=True, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string((files("counterlight.unattended.systemd") / "counterlight.service").read_text())
    service = unit["Service"]
    options = {word for word in service["ExecStart"].split() if word.startswith("--")}
    assert options == {"--supervise", "--fullscreen"}
    help_text = succeed("play", "--help")
    assert all(option in help_text for option in options)
    assert (service["Type"], service["SuccessExitStatus"], service["RestartPreventExitStatus"]) == (
        "notify",
        "130",
        "2",
    )
    assert float(service["WatchdogSec"]) > 10 * heartbeat.INTERVAL_S
    assert float(service["TimeoutStopSec"]) > ENDING_S
    assert float(service["TimeoutStartSec"]) > START_S
