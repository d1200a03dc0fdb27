"""--control of a player in a window: everything in docs/player.md, over the socket, and random lines."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests import player_page
from tests.fuzz.lines import assert_goes_on, faults_told, random_line, send_and_count
from tests.programs import PATIENCE_S, succeed, wait_until
from tests.remote import show
from tests.rooms import write_blurred_room

WITHOUT_SOUND = {"volume", "mute"}
WITHOUT_DEVICE = WITHOUT_SOUND | {"watch-freeze"}
RANDOM_LINES = 600


def test_every_documented_command_and_property_by_the_socket(xvfb: str, small_room: Path, folder: Path) -> None:
    commands, properties = player_page.commands(), player_page.properties()
    arguments = player_page.ARGUMENTS | {"cycle": ["osd"]}
    options = "--loop", "--refine", "4", "--check-with", f"--camera folder:{folder / 'no-camera'}"
    with show(xvfb, folder, small_room, "clip.mkv", "clip.mkv", *options) as (process, client):
        assert sorted(client.get("property-list")) == sorted(properties)
        assert {entry["name"] for entry in client.get("command-list")} == set(commands)
        for number, name in enumerate(properties):
            assert client.ask("observe_property", number, name)["error"] == "success"
        for name in commands:
            if name.startswith("place-"):
                client.ask("place")
            if name not in ("quit", "projector"):  # test_projectors_are_switched runs these commands
                answer = client.ask(name, *arguments.get(name, []))
                assert answer["error"] == "success", answer
                assert name != "screenshot" or Path(folder, answer["data"]).stat().st_size > 100
        found = {name: client.ask("get_property", name) for name in properties}
        assert {name for name in found if found[name]["error"] != "success"} == WITHOUT_DEVICE
        assert all(found[name]["message"] == "no audio" for name in WITHOUT_SOUND)
        wanted = {"view": "camera", "contrast": 2, "osd": "off", "pause": True, "refine": 8, "placing": False}
        assert {name: found[name]["data"] for name in wanted} == wanted
        assert len(found["playlist"]["data"]) == 1  # the command playlist-clear has run
        for name, values in properties.items():
            error = client.ask("set_property", name, found[name].get("data", 50))["error"]
            refusal = "error running command" if name in WITHOUT_DEVICE else "success"
            assert error == ("error accessing property" if values == "read-only" else refusal), name
        assert client.ask("set_property", "pause", False)["error"] == "success"
        frames = client.get("frames")
        wait_until(lambda: client.get("frames") > frames + 5, "the show goes on", process)
        changes = {event["name"]: event["data"] for event in client.events if event["event"] == "property-change"}
        assert changes.keys() == properties.keys()
        assert changes["contrast"] == 2
        assert client.ask("quit")["error"] == "success"
        assert client.ending()[-1] == "shutdown"
        assert process.wait(PATIENCE_S) == 0
    assert not (folder / "show.socket").exists()


def contents(*folders: Path) -> dict[Path, bytes | None]:
    """Return what is there, and the contents of files except the socket and the log."""
    paths = (path for folder in folders for path in sorted(folder.rglob("*")))
    return {path: path.read_bytes() if path.is_file() else None for path in paths}


def test_a_remote_writes_screenshots_and_a_placement_and_nothing_else(
    xvfb: str, small_room: Path, folder: Path
) -> None:
    """Other requests write nothing: command line options are no properties, and commands take no file names."""
    room = folder / "room"
    shutil.copytree(small_room, room)
    (folder / "shots").mkdir()
    outside = folder / "outside"
    options = "--loop", "--screenshot-directory", folder / "shots"
    with show(xvfb, folder, room, "clip.mkv", *options) as (process, client):
        before = contents(folder)
        for name in ("output", "stats", "heartbeat", "control", "screenshot-directory", "config", "media-root", "path"):
            assert client.ask("set_property", name, str(outside))["error"] != "success"
            assert client.ask("set", name, str(outside))["error"] != "success"
        for words in (
            ("screenshot", str(outside)),
            ("screenshot-to-file", str(outside)),
            ("place-save", str(outside)),
            ("run", "/usr/bin/touch", str(outside)),
            ("subprocess", ["/usr/bin/touch", str(outside)]),
            ("load-script", str(outside)),
            ("reload", str(outside)),
        ):
            assert client.ask(*words)["error"] in ("invalid parameter", "error running command"), words
        client.ask("set_property", "stats", True)  # this sets the page named stats, not a file
        for words in (("screenshot",), ("place",), ("place-move", 0.01, 0), ("place-save",), ("reload",)):
            assert client.ask(*words)["error"] == "success"
        new = contents(folder)
        shots = {path for path in new if path.parent == folder / "shots"}
        assert {path: new.get(path) for path in before} == before
        assert new.keys() - before.keys() == shots | {room / "placement.toml"}
        assert [path.suffix for path in shots] == [".png"]
        assert process.poll() is None


@pytest.mark.parametrize("trap", ["pipe", "device", "other size", "gone"])
def test_a_room_that_was_replaced_is_refused_and_the_show_goes_on(
    trap: str, xvfb: str, small_room: Path, folder: Path
) -> None:
    room = folder / "room"
    shutil.copytree(small_room, room)
    with show(xvfb, folder, room, "clip.mkv", "--loop") as (process, client):
        room.rename(folder / "before")
        if trap == "other size":
            write_blurred_room(room, np.random.default_rng(7), (30, 40), (24, 32))
            succeed("build", room, "--regularize", "0.1")
        elif trap != "gone":
            shutil.copytree(small_room, room)
            (room / "correction" / "entries.exr").unlink()
            if trap == "pipe":
                os.mkfifo(room / "correction" / "entries.exr")
            else:
                (room / "correction" / "entries.exr").symlink_to("/dev/zero")
        answer = client.ask("reload")
        assert answer["error"] == "error running command"
        assert answer["message"].startswith("not reloaded: ")
        frames = client.get("frames")
        wait_until(lambda: client.get("frames") > frames + 5, "the show goes on", process)


def test_after_random_lines_it_answers_and_plays(
    xvfb: str, small_room: Path, folder: Path, rng: np.random.Generator
) -> None:
    """No line may end the show or reveal a fault in the player. `make fuzz` sends ten thousand lines."""
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):
        send_and_count(client, (random_line(rng, index) for index in range(RANDOM_LINES)))
        assert_goes_on(client, process, "clip.mkv")
        assert client.ask("quit")["error"] == "success"
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert faults_told(errors) == []
