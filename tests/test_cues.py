"""The position of a show between machines: real sockets, clocks that differ, a network that delays and loses."""

import socket
import time
from collections.abc import Callable

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.unattended.cues import LEAST, MESSAGE, Beacon, ClockOffset, Cue, Heard, Listener, read_address
from tests.udp_proxy import wire

PATIENCE_S = 20.0  # never reached in a passing test
CUE = Cue(3, 12.5, 99.0, 1.5, False, True)


def wait_for(heard: Callable[[], Heard | None], wanted: Callable[[Heard], bool] = lambda heard: True) -> Heard:
    until_s = time.monotonic() + PATIENCE_S
    while (found := heard()) is None or not wanted(found):
        assert time.monotonic() < until_s, found
        time.sleep(0.01)
    return found


@pytest.mark.parametrize("ahead_s", [0.0, -7000.0, 1e8])
def test_the_quickest_round_trips_say_how_far_a_clock_is_ahead(rng: np.random.Generator, ahead_s: float) -> None:
    """With bursts of up to 80 ms each way on 1 ms, the error is at most half of a quick round trip."""
    clock, asked_s = ClockOffset(), 50.0
    for n in range(64):
        there_s, back_s = 1e-3 * rng.uniform(1, 1.2, 2) + (rng.uniform(0, 0.08, 2) if n % 2 else 0)
        clock.add(asked_s, asked_s + there_s + ahead_s, asked_s + there_s + back_s)
        asked_s += 0.2
    assert clock.seconds is not None
    assert clock.round_trip_s is not None
    assert clock.round_trip_s < 3e-3
    assert abs(clock.seconds - ahead_s) <= clock.round_trip_s / 2 + 1e-6  # float64 at 1e8 s


def test_nothing_is_said_of_a_clock_before_enough_is_known() -> None:
    clock = ClockOffset()
    for n in range(LEAST):
        assert clock.seconds is None
        clock.add(n, n + 5, n)
    assert clock.seconds == 5
    clock.forget()
    assert clock.seconds is None


def test_a_follower_hears_the_cue_and_the_clock() -> None:
    beacon = Beacon(("127.0.0.1", 0))
    listener = Listener(beacon.address, lambda: time.monotonic() - 400)
    try:
        beacon.tell(CUE)
        heard = wait_for(lambda: listener.heard, lambda heard: heard.cue == CUE)
        assert abs(heard.offset_s - 400) <= heard.round_trip_s / 2 + 1e-6
        beacon.tell(later := Cue(4, 0.0, 100.0, 1.0, True, False))
        wait_for(lambda: listener.heard, lambda heard: heard.cue == later)
    finally:
        listener.close()
        beacon.close()


def test_over_a_bad_wire_the_clock_is_right_within_half_a_round_trip() -> None:
    beacon = Beacon(("127.0.0.1", 0))
    with wire(beacon.address[1], (0.005, 0.06), 0.3) as between:
        listener = Listener(("127.0.0.1", between.port), lambda: time.monotonic() + 400)
        try:
            beacon.tell(CUE)
            heard = wait_for(lambda: listener.heard, lambda heard: between.lost > 5 and between.passed > 40)
            assert heard.cue == CUE
            assert abs(heard.offset_s + 400) <= heard.round_trip_s / 2 + 1e-6
        finally:
            listener.close()
            beacon.close()


def test_a_leader_that_falls_silent_and_another_that_comes_are_noticed() -> None:
    """Another process has another clock, so the old clock's offset is dropped."""
    first = Beacon(("127.0.0.1", 0))
    listener = Listener(first.address)
    try:
        wait_for(lambda: listener.heard)
        first.close()
        until_s = time.monotonic() + PATIENCE_S
        while listener.heard is not None:
            assert time.monotonic() < until_s
            time.sleep(0.05)
        second = Beacon(first.address, lambda: time.monotonic() + 1000)
        heard = wait_for(lambda: listener.heard)
        second.close()
        assert abs(heard.offset_s - 1000) <= heard.round_trip_s / 2 + 1e-6
    finally:
        listener.close()


def test_a_leader_that_is_not_there_or_has_no_name_is_waited_for() -> None:
    for host in ("127.0.0.1", "no-such-machine.invalid"):
        listener = Listener((host, 1))
        time.sleep(0.3)
        assert listener.heard is None
        listener.close()


def test_strangers_get_no_more_than_they_send_and_change_nothing(rng: np.random.Generator) -> None:
    beacon = Beacon(("127.0.0.1", 0))
    beacon.tell(CUE)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(beacon.address)
        stranger.settimeout(0.3)
        good = MESSAGE.pack(b"CLc1", 3, 1, 7, 1.0, 2.0, 5, 6.0, 7.0, 8.0)
        for data in (b"", b"x", good[:-1], good + b"x", b"XX" + good[2:], rng.bytes(MESSAGE.size), rng.bytes(1400)):
            stranger.send(data)
        with pytest.raises(TimeoutError):
            stranger.recv(2048)
        stranger.send(good)
        answer = stranger.recv(2048)
        assert len(answer) == len(good)
        assert MESSAGE.unpack(answer)[4:5] + MESSAGE.unpack(answer)[6:] == (1.0, 3, 12.5, 99.0, 1.5)
    beacon.close()


def test_answers_of_others_or_without_sense_are_not_taken(rng: np.random.Generator) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as leader:
        leader.bind(("127.0.0.1", 0))
        leader.settimeout(PATIENCE_S)
        listener = Listener(leader.getsockname())
        nan = float("nan")
        try:
            for n in range(20):
                question, follower = leader.recvfrom(2048)
                number = MESSAGE.unpack(question)[3]
                for wrong in (
                    # the answer to a question that was not asked
                    MESSAGE.pack(b"CLc1", 2, 1, number + 1, 0, 1.0, 0, 1.0, 1.0, 1.0),
                    MESSAGE.pack(b"CLc1", 2, 1, number, 0, nan, 0, 1.0, 1.0, 1.0),
                    rng.bytes(MESSAGE.size),
                    b"CLc1",
                ):
                    leader.sendto(wrong, follower)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                    other.sendto(MESSAGE.pack(b"CLc1", 2, 1, number, 0, 1.0, 0, 1.0, 1.0, 1.0), follower)
                assert listener.heard is None, n
        finally:
            listener.close()


@pytest.mark.parametrize(
    ("text", "defaults", "expected"),
    [
        ("7000", {"host": ""}, ("", 7000)),
        ("10.0.0.1:7000", {"host": ""}, ("10.0.0.1", 7000)),
        ("[::1]:7000", {"host": ""}, ("::1", 7000)),
        ("left.local", {"port": 7325}, ("left.local", 7325)),
        ("left.local:80", {"port": 7325}, ("left.local", 80)),
        ("[fe80::1]", {"port": 7325}, ("fe80::1", 7325)),
    ],
)
def test_addresses(text: str, defaults: dict[str, str | int], expected: tuple[str, int]) -> None:
    assert read_address(text, **defaults) == expected  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text", ["", "x:", ":", "x:0", "x:65536", "x:٣", "fe80::1:80", "a..b:80", f"{'x' * 70}:80", "x:-1"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of which UnicodeError is one
        read_address(text)


def test_a_port_that_is_taken_is_reported_in_a_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"--lead 127.0.0.1:{port}: cannot listen there .*; give another port"):
            Beacon(("127.0.0.1", port))
    with pytest.raises(InputError, match=r"--lead 192\.0\.2\.1:7000: cannot listen there"):
        Beacon(("192.0.2.1", 7000))
