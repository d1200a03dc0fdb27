"""docs/player.md in a real window: every key is pressed, every command run, every property read and set."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from counterlight.show.keys import KEYS, PLACING
from counterlight.show.watching import ABSENT
from tests.desktop import click, press
from tests.player_page import ARGUMENTS, commands, keys, properties
from tests.programs import PATIENCE_S, ROOT, on, running

State = dict[str, Any]
SYMBOLS = {
    ".": "period",
    ",": "comma",
    "<": "less",
    ">": "greater",
    "?": "question",
    "[": "bracketleft",
    "]": "bracketright",
    "+": "plus",
    "=": "equal",
    "-": "minus",
    "left": "Left",
    "right": "Right",
    "up": "Up",
    "down": "Down",
    "escape": "Escape",
    "enter": "Return",
    "tab": "Tab",
    "backspace": "BackSpace",
    "ctrl": "Control_L",
    "shift": "Shift_L",
}
BUTTONS = {"double-click": (1, 2), "wheel-up": (4,), "wheel-down": (5,), "wheel-left": (6,), "wheel-right": (7,)}


def walking(display: str, folder: Path, *arguments: object) -> AbstractContextManager[subprocess.Popen[str]]:
    words = sys.executable, "-W", "error", "-m", "tests.walk_player", *arguments
    return running(*words, folder=folder, errors=None, PYTHONPATH=str(ROOT), **on(display))


def test_the_page_lists_the_keys() -> None:
    for number, bindings in enumerate((KEYS, PLACING)):
        assert sorted(keys(number)) == sorted(bindings)


def test_every_documented_key(xvfb: str, small_room: Path, folder: Path) -> None:
    """Each key, really pressed, changes its command's property, prints its action, or writes its file."""
    with walking(xvfb, folder, "watch", small_room, "clip.mkv", "clip.mkv", "--loop") as process:
        states: SimpleQueue[State] = SimpleQueue()

        def listen() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith("{"):
                    states.put(json.loads(line))

        threading.Thread(target=listen, daemon=True).start()
        now = latest = states.get(timeout=PATIENCE_S)

        def reach(key: str, arrived: Callable[[State, State], bool]) -> State:
            nonlocal latest
            said_before = (
                "no audio",
                latest["message"] if key == "ctrl+wheel-right" else None,
            )  # the end of a loop is its start
            while not states.empty() or latest["message"] in said_before:
                latest = states.get(timeout=PATIENCE_S)
            *held, plain = key.split("+") if len(key) > 1 else [key]
            if plain in BUTTONS:
                click(xvfb, *BUTTONS[plain], held=tuple(SYMBOLS[name] for name in held))
            else:
                press(xvfb, SYMBOLS.get(plain, plain), *(SYMBOLS[name] for name in held))
            while True:
                try:
                    latest = states.get(timeout=PATIENCE_S)
                except Empty:
                    pytest.fail(f"{key}: nothing came of it")
                if arrived(now, latest):
                    return latest

        for key, words in ((key, KEYS[key]) for key in keys()):
            if key not in ("q", "k"):
                now = reach(key, arrival(words))
        assert list(folder.glob("counterlight-*.png"))
        now = reach("escape", lambda before, after: not after["help"])  # the key ? has opened the help
        for key, words in ((key, PLACING[key]) for key in keys(1)):
            if not now["placing"]:
                now = reach("k", arrival("place"))
            now = reach(key, arrival(words))
        press(xvfb, "q")
        assert process.wait(PATIENCE_S) == 0


def arrival(words: str) -> Callable[[State, State], bool]:
    """Return the event that shows that a key's command is done."""
    name, *rest = words.split()
    if name in ("cycle", "add", "multiply", "set"):
        if rest[0] in ("volume", "mute"):
            return lambda before, after: after["message"] == "no audio"
        if name == "set":
            return lambda before, after: after[rest[0]] is False
        return lambda before, after: bool(after[rest[0]] != before[rest[0]])
    patterns = {
        "seek": r"\d:\d\d:\d\d / ",
        "show-progress": r"\d:\d\d:\d\d / ",
        "ab-loop": "A-B loop",
        "screenshot": r"\.png$",
        "identify": "this is screen",
        "reload": "reloaded",
        "place-corner": "corner|whole",
        "playlist-next": "^[12]/2 ",
        "playlist-prev": "^[12]/2 ",
    }
    if name in patterns:
        return lambda before, after: re.search(patterns[name], after["message"]) is not None
    if name == "show-keys":
        return lambda before, after: bool(after["help"])
    if name.startswith("frame"):
        return lambda before, after: bool(after["pause"])
    if name == "place":
        return lambda before, after: bool(after["placing"])
    if name in ("place-save", "place-cancel"):
        return lambda before, after: not after["placing"]
    return lambda before, after: after["corners"] != before["corners"] or after["message"] == "nothing to take back"


def test_every_documented_command_and_property(xvfb: str, small_room: Path, folder: Path) -> None:
    calls: list[list[object]] = []
    for name in commands():
        if name.startswith("place-"):
            calls.append(["run", "place"])
        if name not in ("quit", "projector"):  # test_projectors_are_switched runs these commands
            calls.append(["run", name, *ARGUMENTS.get(name, [])])
    calls += [["run", "place"], ["run", "place-move", 0.1, 0], ["run", "place-save"]]
    names = [*properties().items()]
    calls += [["get", name] for name, _ in names]
    (folder / "calls.json").write_text(json.dumps(calls))
    first = answers(xvfb, folder, small_room)
    found = {answer["call"][1]: answer.get("result") for answer in first if answer["call"][0] == "get"}
    for answer in first:
        assert answer.get("error") in (None, "no audio", ABSENT), answer
    assert {answer["call"][1] for answer in first if "error" in answer} == {"volume", "mute", "watch-freeze"}
    expected = {"view": "camera", "contrast": 2, "compensation": True, "duration": pytest.approx(5)}
    assert {name: found[name] for name in expected} == expected
    assert len(found["playlist"]) == 1  # playlist-clear is the last command that edits it
    assert found["refine"] == 8
    assert 0 <= found["gap"] < np.inf  # 0 at the clip's start: the picture is darker than the room, whatever the drive
    assert 10 < found["psnr"] < 80
    assert len(found["corners"]) == 4
    assert (small_room / "placement.toml").exists()
    setting = [["set", name, found[name]] for name, _ in names]
    (folder / "calls.json").write_text(json.dumps([*setting, ["set", "fullscreen", True], ["get", "fullscreen"]]))
    second = answers(xvfb, folder, small_room)
    read_only = {name for name, values in names if values == "read-only"}
    refused = {answer["call"][1]: answer["error"] for answer in second if "error" in answer}
    assert refused.keys() == read_only | {"volume", "mute", "watch-freeze"}
    assert all(refused[name] == f"{name} is read-only" for name in read_only)
    assert second[-1]["result"] is True


def answers(display: str, folder: Path, room: Path) -> list[dict[str, Any]]:
    options = "--loop", "--refine", "4", "--check-with", f"--camera folder:{folder / 'no-camera'}"
    with walking(display, folder, "run", folder / "calls.json", room, "clip.mkv", "clip.mkv", *options) as process:
        out, _ = process.communicate(timeout=3 * PATIENCE_S)
    assert process.returncode == 0
    return [json.loads(line) for line in out.splitlines() if line.startswith("{")]
