"""Waiting for parts that are not there yet: intervals, lines, and what a heartbeat says."""

import json
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from counterlight.errors import AbsentError, InputError
from counterlight.gl.monitors import Monitor, find_monitor
from counterlight.unattended import waiting
from counterlight.unattended.heartbeat import Heartbeat, Notifier
from counterlight.unattended.waiting import LONGEST_RETRY_S, retry_s, wait_for
from tests.stage import Clock
from tests.test_heartbeat import received


def failing(*errors: Exception) -> Callable[[], str]:
    left = list(errors)

    def find() -> str:
        if left:
            raise left.pop(0)
        return "found"

    return find


def test_intervals_grow_to_their_limit() -> None:
    assert [retry_s(tries) for tries in range(6)] == [1, 2, 4, 8, 16, LONGEST_RETRY_S]
    assert retry_s(10_000) == LONGEST_RETRY_S


def test_each_reason_is_printed_once_and_the_heartbeat_names_it(
    tmp_path: Path, manager: socket.socket, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock(0.0)

    def sleep(seconds: float) -> None:
        clock.now += seconds

    monkeypatch.setattr(waiting, "time", SimpleNamespace(monotonic=clock, sleep=sleep))
    heart = Heartbeat(tmp_path / "log", Notifier(str(tmp_path / "notify")), clock=clock)
    assert (
        wait_for(failing(AbsentError("no screen"), AbsentError("no screen"), AbsentError("no monitor")), heart)
        == "found"
    )
    assert clock.now == pytest.approx(1 + 2 + 4, abs=0.5)  # the polls of three waits
    clock.now += 1
    heart.beat({"path": "film.mp4"})
    heart.close()
    assert capsys.readouterr().err.splitlines() == ["waiting: no screen", "waiting: no monitor", "waiting: over"]
    *waits, last = (json.loads(line) for line in (tmp_path / "log").read_text().splitlines())
    assert {each["waiting"] for each in waits} == {"no screen", "no monitor"}
    assert "waiting" not in last
    beats = [received(manager) for _ in range(len(waits) + 1)]
    assert ["READY" in beat for beat in beats] == [False] * len(waits) + [True]
    assert beats[0]["STATUS"] == "waiting no screen"


def test_wrong_use_and_a_user_at_the_terminal_do_not_wait(tmp_path: Path) -> None:
    heart = Heartbeat(tmp_path / "log", Notifier(None))
    with pytest.raises(InputError, match="wrong use"):
        wait_for(failing(InputError("wrong use")), heart)
    with pytest.raises(AbsentError, match="no screen"):
        wait_for(failing(AbsentError("no screen")), None)
    heart.close()
    assert (tmp_path / "log").read_text() == ""


def test_a_monitor_that_is_switched_on_later_counts_as_absent() -> None:
    with pytest.raises(AbsentError, match="HDMI-9"):
        find_monitor([Monitor(0, "HDMI-1", 1920, 1080, 60, 0, 0, primary=True)], "HDMI-9")
