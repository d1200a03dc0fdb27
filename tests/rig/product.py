"""The product as its user meets it: documented commands in separate processes, with folders and pictures between them.

This module contains every call of a command.
"""

import json
import re
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from tests.programs import running, succeed, verb
from tests.rig.rig import Rig

WAIT_S, POLL_S = 300, 0.05
NAMES = "red", "green", "blue"
WHITE = re.compile(r"white is a camera radiance of ([\d.e+-]+)")


# counts of one check with a picture, by the product's interval
COVERED = re.compile(
    r"(?P<inside>[\d.]+) % of the captured values are inside .*\(dark (?P<dark>[\d.]+), middle (?P<middle>[\d.]+), "
    r"bright (?P<bright>[\d.]+) %\), whose mean width is (?P<width>[\d.]+) % .* would need (?P<constant>[\d.]+) %"
)
EXPECTED = re.compile(r"expected on the wall: .* about ([\d.]+) dB")


@dataclass(frozen=True)
class Shown:
    """A picture as the product would show it.

    codes : (height, width, 3), sent to the projector.
    white : radiance of a white picture.
    """

    codes: NDArray[np.uint8]
    white: float


def acquire(rig: Rig, folder: Path, *options: str, seed: int = 0) -> str:
    """Make the calibration `folder`/room with the rig's camera; returns the command's output.

    While the command waits for the captures of a level, the rig photographs the patterns that the command has written.
    """
    exchange, room = folder / "exchange", folder / "room"
    return _photographed(rig, exchange, seed, folder / "acquire.log", "acquire", "-o", room, *options)


def check(rig: Rig, folder: Path, *options: object, seed: int = 1) -> str:
    """Check the room in its present state with the rig's camera; returns the command's output."""
    exchange, room = folder / f"check-{seed}", folder / "room"
    return _photographed(rig, exchange, seed, folder / "check.log", "verify", room, *options)


def covered(rig: Rig, folder: Path, picture: Path, *options: object, seed: int) -> dict[str, float]:
    """Show and photograph a picture once; returns percent inside the interval, and widths in percent of white."""
    found = COVERED.search(said := check(rig, folder, picture, "--repeats", 1, *options, seed=seed))
    assert found, said
    return {name: float(value) for name, value in found.groupdict().items()}


def expected_decibels(said: str) -> float:
    """Returns how well captures will match the prediction, from the output of an acquisition."""
    found = EXPECTED.search(said)
    assert found, said
    return float(found[1])


def forget(folder: Path) -> None:
    """Remove the drift that a check has found."""
    shutil.rmtree(folder / "room" / "drift", ignore_errors=True)


def write_response(path: Path, table: list[list[float]]) -> Path:
    """Write a projector's measured curve, for --response."""
    path.write_text(f"response = {json.dumps(table)}\n")
    return path


def build(folder: Path, colour: str = "") -> str:
    """Build the room.

    colour : for --colour; the default if empty.
    """
    return succeed("build", folder / "room", *(("--colour", colour) if colour else ()))


def show(folder: Path, picture: Path, *options: str) -> Shown:
    """Show `picture` through the room's correction, in eight bits."""
    drive = folder / "drive.png"
    said = succeed("play", folder / "room", picture, "--no-config", "--output", drive, *options)
    found = WHITE.search(said)
    assert found, said
    codes = cv2.imread(str(drive), cv2.IMREAD_COLOR)
    assert codes is not None, drive
    return Shown(codes[..., ::-1].copy(), float(found[1]))


def show_plain(folder: Path, picture: Path) -> Shown:
    """Show a picture as any player would."""
    return show(folder, picture, "--no-compensation")


def floodlight(folder: Path) -> NDArray[np.float32]:
    """Returns the light of white above black as the room stores it, (camera height, camera width, 3)."""
    total = sum(OpenEXR.File(str(folder / "room" / f"primary_{name}.exr")).channels()["RGB"].pixels for name in NAMES)
    return np.asarray(total, np.float32)


def refining(steps: int) -> tuple[str, ...]:
    """Returns the options for `steps` steps of refinement."""
    return "--refine", str(steps)


def _photographed(rig: Rig, exchange: Path, seed: int, log: Path, name: str, *words: object) -> str:
    """Run a command, and photograph its new patterns while it waits for the captures of a level."""
    height, width = rig.raster
    camera = "--camera", f"folder:{exchange}", "--projector", f"{width}x{height}", "--wait", WAIT_S
    with log.open("w") as errors, running(*verb(name), *words, *camera, errors=errors.fileno()) as process:
        while process.poll() is None:
            photograph_new(rig, exchange, seed)
            time.sleep(POLL_S)
        assert process.stdout
        said = process.stdout.read()
    assert process.returncode == 0, said + log.read_text()
    return said


def photograph_new(rig: Rig, exchange: Path, seed: int) -> None:
    """Photograph patterns without a capture. Captures are renamed into place, so that no process reads half a file."""
    stored = rig.devices.stored
    for path in sorted((exchange / "patterns").glob("[0-9]*.png")):
        target = exchange / "captures" / f"{path.stem}{stored.suffix}"
        if target.exists():
            continue
        shown = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert shown is not None, path
        capture = rig.photograph(shown[..., ::-1], seed, int(path.stem))
        begun = target.with_name(f".{target.name}")
        begun.write_bytes(stored.content(capture))
        begun.rename(target)
