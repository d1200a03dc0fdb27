"""Damaged rooms: every file of a calibration with far light, its maps and a placement.

A changed file with its old checksum must be refused. With a new checksum, as an attacker would write, the room may be
read. A room that is read can be built, and its pictures are finite.
"""

import shutil
import tomllib
from pathlib import Path

import numpy as np

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import FOLDER
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.placement import read_placement, write_placement
from counterlight.pipeline.room import read_room
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from tests.fuzz.tally import LEFT, READ, REFUSED, WRONG, Trial
from tests.fuzz.warden import Case, FileCampaign
from tests.mutants import MANIFEST_NAME, DamagedRoom, mutant, outcome
from tests.rooms import rgb_frame, write_blurred_room

CAMERA, PROJECTOR, CELLS = (13, 18), (10, 14), 4
CORNERS = (0.1, 0.2), (0.9, 0.1), (1.05, 0.9), (-0.02, 0.8)
RENEWED, OLD, BUILT = "checksums renewed", "old checksums", "checksums renewed, built again"
HOWS = OLD, OLD, RENEWED, RENEWED, RENEWED, BUILT


class Calibrations(FileCampaign):
    """A mutant of one file of a room, in the file's place."""

    name, count = "calibrations", 800
    purpose = "damaged files of a room with maps, under their old and under renewed checksums"

    def furnish(self, folder: Path) -> None:
        write_blurred_room(folder / "original", np.random.default_rng(1), CAMERA, PROJECTOR, CELLS)
        build_room_maps(calibration.read(folder / "original"), InverseOptions())
        write_placement(folder / "original", CORNERS)

    def open(self, folder: Path) -> None:
        shutil.rmtree(folder / "room", ignore_errors=True)
        shutil.copytree(folder / "original", folder / "room")
        self._room = DamagedRoom.of(folder / "room")
        self._names = sorted(self._room.files)
        self._described = set(tomllib.loads(self._room.files[calibration.TOML].decode())["files"]) | {calibration.TOML}
        listed = tomllib.loads(self._room.files[MANIFEST_NAME].decode())["files"]
        self._described |= {f"{FOLDER}/{name}" for name in listed}
        self._shown()  # Numba compiles now, so that no trial includes the time

    def draw(self, rng: np.random.Generator) -> Case:
        name = self._names[rng.integers(len(self._names))]
        how = HOWS[rng.integers(len(HOWS))]
        return Case({name: mutant(self._room.files[name], name, rng)}, f"{name}, {how}")

    def judge(self, case: Case) -> Trial:
        ((name, content),) = case.files.items()
        how = case.how.removeprefix(f"{name}, ")
        self._room.put(name, content, renewed=how != OLD)
        try:
            return self._judged(name, content, how)
        finally:
            self._restore()

    def _judged(self, name: str, content: bytes, how: str) -> Trial:
        if outcome(self._room.read) == REFUSED:
            return Trial(REFUSED)
        if how == OLD and name in self._described and content != self._room.files[name]:
            return Trial(WRONG, "read, though its checksum is another file's")
        if how == BUILT and outcome(self._build) == REFUSED:
            return Trial(REFUSED, "by the build")
        complaint = self._shown()
        strangers = {path.relative_to(self._room.folder).as_posix() for path in self._room.folder.rglob(".*")}
        if strangers:
            return Trial(LEFT, ", ".join(sorted(strangers)))
        return Trial(WRONG, complaint) if complaint else Trial(READ)

    def _build(self) -> None:
        build_room_maps(calibration.read(self._room.folder), InverseOptions())

    def _shown(self) -> str:
        """Return the fault in the pictures that a player makes of the room; empty if there is none."""
        try:
            room, corners = read_room(self._room.folder, None), read_placement(self._room.folder)
        except InputError as error:
            return f"the player refuses what was read: {error}"
        picture = np.random.default_rng(5).integers(0, 256, (9, 12, 3), np.uint8)
        renderer = CpuRenderer(room)
        frame = rgb_frame(picture)
        renderer.open(frame.format)
        renderer.adjust(Adjustments(corners=corners))
        renderer.upload(frame)
        for view in ("projector", "camera"):
            renderer.render(view, compensate=True, steps=2)
            if not np.isfinite(renderer.linear()).all():
                return f"the {view}'s picture is not finite"
            renderer.encoded()
        return ""

    def _restore(self) -> None:
        """Restore every file, whatever was built in the meantime."""
        for path in sorted(self._room.folder.rglob("*"), reverse=True):
            if path.is_file() and path.relative_to(self._room.folder).as_posix() not in self._room.files:
                path.unlink()
        for name, content in self._room.files.items():
            path = self._room.folder / name
            path.parent.mkdir(exist_ok=True)
            if not path.is_file() or path.read_bytes() != content:
                path.write_bytes(content)
