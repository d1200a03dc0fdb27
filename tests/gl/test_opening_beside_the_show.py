"""A show in a window continues while media never finish opening, and after media that cannot be played."""

import os
import socket
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from counterlight.errors import printable
from tests.canaries import canary
from tests.desktop import playing, press
from tests.media import numbered, write_video
from tests.programs import PATIENCE_S, command, on, wait_until
from tests.remote import Client, on_any_machine, show
from tests.test_border import FFCONCAT, HLS


@pytest.fixture
def mute_peer() -> Any:
    """Open a port that accepts connections and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


def plays_on(client: Client, process: Any, frames: int = 10) -> None:
    """Wait until that many more frames are shown."""
    before = client.get("frames")
    wait_until(lambda: client.get("frames") >= before + frames, "the show goes on", process)


def told(client: Client, words: str) -> Callable[[], bool]:
    return lambda: any(words in notice for notice in client.get("notices"))


def test_keys_socket_and_heartbeat_answer_while_a_peer_says_nothing(
    xvfb: str, small_room: Path, folder: Path, mute_peer: str
) -> None:
    options = "--loop", "--allow-live", "--heartbeat", folder / "log"
    with show(xvfb, folder, small_room, "clip.mkv", *options) as (process, client):
        assert client.ask("loadfile", mute_peer)["error"] == "success"
        assert client.get("playlist") == [mute_peer]
        for _ in range(3):  # each request would have to wait for the peer
            plays_on(client, process)
            compensation = client.get("compensation")
            press(xvfb, "c")
            wait_until(lambda before=compensation: client.get("compensation") != before, "a key", process)
            beats = len((folder / "log").read_text().splitlines())
            wait_until(lambda n=beats: len((folder / "log").read_text().splitlines()) > n, "a beat", process)
        assert client.get("path") == "clip.mkv"
        wait_until(told(client, f"{mute_peer}: "), "it is passed over", process)
        assert client.get("playlist") == ["clip.mkv"]
        plays_on(client, process)
        client.ask("loadfile", mute_peer)
        plays_on(client, process)
        assert client.ask("quit")["error"] == "success"  # while the medium is still opening
        assert process.wait(PATIENCE_S) == 0


def test_a_remote_names_files_below_its_roots_and_nothing_else(xvfb: str, small_room: Path, folder: Path) -> None:
    outside = folder.parent / f"{folder.name}-outside"
    outside.mkdir()
    (outside / "secret.mkv").write_bytes((folder / "clip.mkv").read_bytes())
    (folder / "link.mkv").symlink_to(outside / "secret.mkv")
    (folder / "copy.mkv").write_bytes((folder / "clip.mkv").read_bytes())
    (folder / "list.m3u").write_text(f"{outside / 'secret.mkv'}\n{folder / 'copy.mkv'}\n")
    os.mkfifo(folder / "pipe.mkv")
    written = folder / "written"
    with canary() as bird, show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):
        bird.watch(outside / "secret.mkv")
        (folder / "list.mp4").write_text(FFCONCAT.format("copy.mkv"))
        (folder / "list.hls").write_text(HLS.format(f"http://127.0.0.1:{bird.port}/x.ts"))
        filters = f"testsrc=d=1,metadata=mode=add:key=a:value=b,metadata=mode=print:file={written}"
        for name in (
            f"lavfi:{filters}",
            f"tcp://127.0.0.1:{bird.port}",
            "v4l2:/dev/video0",
            "/dev/zero",
            "/etc/passwd",
            "link.mkv",
            "pipe.mkv",
            "../" + outside.name + "/secret.mkv",
            f"http://127.0.0.1:{bird.port}/x.mkv",
            "concat:copy.mkv|copy.mkv",
        ):
            for how in ("replace", "append"):
                assert client.ask("loadfile", name, how)["error"] == "error running command", name
        for name in ("list.mp4", "list.hls"):  # only opening these files reveals the fault
            assert client.ask("loadfile", name)["error"] == "success"
            wait_until(told(client, f"{name}: "), "it is passed over", process)
        assert client.get("playlist") == ["clip.mkv"]
        assert client.ask("loadfile", "list.m3u")["error"] == "success"
        wait_until(lambda: client.get("path") == str(folder / "copy.mkv"), "what may be played of the list", process)
        plays_on(client, process)
        assert bird.touched() == set()
    assert not written.exists()


def test_names_that_are_no_text_end_no_show_and_command_no_terminal(xvfb: str, small_room: Path, folder: Path) -> None:
    names = os.fsdecode(b"\xff\xfe.mkv"), "a\x1b]0;mine\x07\n.mkv"
    for name in names:
        (folder / name).write_bytes((folder / "clip.mkv").read_bytes())
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):
        for name in names:
            assert client.ask("loadfile", name)["error"] == "success"
            wait_until(lambda name=name: client.get("path") == name, "it plays", process)
            (folder / name).write_bytes(b"no video at all" * 100)
            client.ask("loadfile", name)
            wait_until(told(client, f"{printable(name)}: FFmpeg cannot read it"), "it is told", process)
            plays_on(client, process)
        client.ask("quit")
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    told_of = [line.partition(": ")[0] for line in on_any_machine(errors.splitlines())]
    assert told_of == [r"\udcff\udcfe.mkv", r"a\x1b]0;mine\x07\n.mkv"]
    for name in names:
        done = command("play", small_room, folder / f"{name}.gone", "--no-config", **on(xvfb))
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
        assert done.stderr.strip().isprintable()


def test_a_list_on_the_command_line_cannot_write_files(xvfb: str, small_room: Path, folder: Path) -> None:
    written = folder / "written"
    graph = f"testsrc=d=1,metadata=mode=add:key=a:value=b,metadata=mode=print:file={written}"
    (folder / "list.m3u").write_text(f"lavfi:{graph}\nclip.mkv\n")
    listed = folder / "list.m3u"
    done = command("play", small_room, listed, "--no-config", "--no-audio", "--frames", "3", **on(xvfb))
    assert done.returncode == 0, done.stderr
    assert "only the command line may name devices and filters" in done.stderr
    assert not written.exists()


def test_what_cannot_be_played_never_ends_a_remote_controlled_show(xvfb: str, small_room: Path, folder: Path) -> None:
    (folder / "broken.mkv").write_bytes(b"no video at all" * 100)
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):
        assert "no such file" in client.ask("loadfile", "nope.mp4", "append")["message"]
        assert client.ask("loadfile", "broken.mkv", "append")["error"] == "success"
        for _ in range(3):
            client.ask("playlist-next")
            wait_until(told(client, "broken.mkv: "), "it is told", process)
            plays_on(client, process)
            client.ask("show-text", "", 1)
        write_video(folder / "fresh.mkv", [numbered(n) for n in range(20)])
        (folder / "fresh.mkv").replace(folder / "broken.mkv")
        client.ask("set_property", "loop-file", False)
        wait_until(lambda: client.get("path") == "broken.mkv", "it plays when it can be played", process)
        assert process.wait(PATIENCE_S) == 0  # then the list ends


@pytest.mark.parametrize("last", ["good", "bad"])
def test_a_list_without_a_remote_ends_and_says_whether_it_ended_well(
    last: str, xvfb: str, small_room: Path, folder: Path
) -> None:
    good, bad = folder / "good.mkv", folder / "bad.mkv"
    write_video(good, [numbered(n) for n in range(5)])
    bad.write_bytes(b"no video at all" * 100)
    media = (bad, good) if last == "good" else (good, bad)
    done = command("play", small_room, *media, "--no-config", "--no-audio", **on(xvfb))
    (line,) = done.stderr.splitlines()
    assert "bad.mkv: FFmpeg cannot read it" in line
    assert (done.returncode, line.startswith("error: ")) == ((0, False) if last == "good" else (2, True))


def test_a_looping_show_of_nothing_stays_on_and_black(xvfb: str, small_room: Path, folder: Path) -> None:
    with playing(
        xvfb, small_room, "late.mkv", "--no-config", "--loop", "--control", "socket", folder=folder
    ) as process:
        wait_until((folder / "socket").exists, "the socket", process)
        with closing(Client(folder / "socket")) as client:
            wait_until(told(client, "late.mkv: no such file"), "it is told", process)
            assert client.ask("get_property", "path")["error"] == "error running command"
            (folder / "clip.mkv").rename(folder / "late.mkv")
            plays_on(client, process)
