"""Three players on one machine, each in a window: a leader, and followers over a slow and lossy network."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from tests.programs import PATIENCE_S
from tests.remote import Client, show
from tests.udp_proxy import Wire, wire

FRAME_S = 0.04
SAMPLES = 60
WIRES = ((0.0, 0.0), 0.0), ((0.005, 0.04), 0.25)  # a cable; a bad radio link: delay range in each direction, loss


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two minutes of video, so that nothing loops during a test."""
    path = tmp_path_factory.mktemp("clip") / "clip.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index in range(3000):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), index % 256, np.uint8), format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def origin_s(client: Client) -> float:
    """Return the clock time at which the medium's time 0 was or would have been shown.

    A frame is requested up to its duration after its time, and may be late. The earliest of many is the closest.
    """
    found = []
    for _ in range(SAMPLES):
        position_s = client.get("time-pos")
        found.append(time.monotonic() - position_s)
        time.sleep(0.013)  # not synchronous with frames
    return min(found)


def assert_in_step(leader: Client, followers: list[Client]) -> None:
    """Wait until media times agree within a frame, however long this takes."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        origin = origin_s(leader)
        apart = [abs(origin_s(follower) - origin) for follower in followers]
        if max(apart) < FRAME_S:
            return
        assert time.monotonic() < until_s, apart


@contextmanager
def three(xvfb: str, room: Path, clip: Path, folder: Path) -> Iterator[tuple[Client, list[Client], list[Wire]]]:
    port = free_port()
    options = room, clip, clip, "--refine", "0"
    with ExitStack() as stack:
        names = "leader", "cable", "radio"
        for name in names:
            (folder / name).mkdir()
        _, leader = stack.enter_context(show(xvfb, folder / "leader", *options, "--lead", f"127.0.0.1:{port}"))
        wires = [stack.enter_context(wire(port, *kind)) for kind in WIRES]
        followers = []
        for name, between in zip(names[1:], wires, strict=True):
            address = f"127.0.0.1:{between.port}"
            followers.append(stack.enter_context(show(xvfb, folder / name, *options, "--follow", address))[1])
        yield leader, followers, wires


def test_followers_keep_in_step_over_good_and_bad_wires(
    xvfb: str, small_room: Path, clip: Path, tmp_path: Path
) -> None:
    with three(xvfb, small_room, clip, tmp_path) as (leader, followers, wires):
        assert_in_step(leader, followers)
        leader.ask("seek", 60, "absolute")
        assert_in_step(leader, followers)
        leader.ask("set_property", "pause", True)
        until_s = time.monotonic() + PATIENCE_S
        while {client.get("time-pos") for client in followers} != {leader.get("time-pos")}:
            assert time.monotonic() < until_s
        leader.ask("set_property", "pause", False)
        leader.ask("set_property", "playlist-pos", 1)
        until_s = time.monotonic() + PATIENCE_S
        while {client.get("playlist-playing-pos") for client in (leader, *followers)} != {1}:
            assert time.monotonic() < until_s
        assert_in_step(leader, followers)
        assert leader.get("in-step") == {"role": "lead"}
        state = followers[1].get("in-step")
        assert state["role"] == "follow"
        assert state["round_trip_ms"] >= 10  # twice the shortest delay of the network
        for between in wires:
            between.cut = True
        while followers[1].get("in-step")["in_touch"]:
            assert time.monotonic() < until_s + PATIENCE_S
        before = followers[1].get("frames")
        leader.ask("quit")
        while followers[1].get("frames") < before + 10:  # the show continues
            assert time.monotonic() < until_s + 2 * PATIENCE_S
