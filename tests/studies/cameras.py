"""One and two projectors, one and two cameras on a folded wall: python -m tests.studies.cameras (docs/cameras.md).

The room is the shipped scene `folded_wall`, small. An audience's camera between both cameras, unknown to the product,
judges. The figures are the error of a grey target over the whole wall and at the end of the first camera's view.
"""

import argparse
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.content import psnr
from counterlight.pipeline.fitting import on_cameras
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.show.headless import headless_renderer
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import BuiltRoom, build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.joining.cameras import CameraOptions, joined_cameras
from counterlight.tools.joining.shared_screen import brightened
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.transport import Transport
from tests.camera_rooms import looks_at
from tests.joint_rooms import lit_by

CAMERA, PROJECTOR = (120, 160), (54, 96)
SECOND = np.array([0.5, 0.15, -0.1])  # position of the second projector relative to the first
AUDIENCE = "position = [0.0, 0.0, 2.7]\nlook_at = [0.0, 0.0, 0.0]"
WHITE, GREY = 0.45, 0.3
STEPS = 8
OTHER_LIGHT = (0.8, 1.0, 1.25)  # gain of the second camera, where exposures and colours differ
COLUMNS = (
    "projectors, cameras",
    "camera pixels that count",
    f"below the joint optimum after {STEPS} steps: from T⁺, from direct mapping",
    "grey off: first camera's part, both's, second's",
    "build, processor",
    "maps",
)
RoomSeen = tuple[Calibration, Transport]


@dataclass(frozen=True)
class Wall:
    """The folded wall under one or two projectors, as its cameras and the audience see it."""

    scene: Scene
    audience: Scene

    @classmethod
    def shipped(cls, folder: Path) -> "Wall":
        path = shipped_scenes()["folded_wall"]
        moved = re.sub(r"position = \[-0.8.*\]\nlook_at = .*", AUDIENCE, path.read_text(), count=1)
        (folder / "audience.toml").write_text(moved)
        return cls(*(load_scene(each).resized(CAMERA, PROJECTOR) for each in (path, folder / "audience.toml")))

    def seen(self, scene: Scene, projectors: int) -> RoomSeen:
        """Returns the room of one camera under projectors side by side."""
        beside = replace(scene.projector, position=scene.projector.position + SECOND)
        return lit_by([scene, replace(scene, projector=beside)][:projectors])


class Judged:
    """A built room, compared with the joint optimum and seen by the audience."""

    def __init__(self, room: RoomSeen, audience: RoomSeen, sides: dict[str, FloatArray]) -> None:
        self._audience, self._sides = audience, sides
        start = time.process_time()
        self.built: BuiltRoom = build_maps(tier_of(*room), InverseOptions())
        self.seconds = time.process_time() - start
        self._calibration, self._transport = room

    def below_optimum(self, start: str) -> float:
        """Returns the loss in dB of PSNR of a photograph after STEPS steps."""
        picture = on_cameras(BUILT_IN["photograph"](self._calibration.placed_on), self._calibration)
        wanted = WHITE * picture
        b = (wanted - self._calibration.ambient).reshape(-1, 3)
        best = Box(objective_of(self._transport, self._calibration, DEFAULT_AIMS)).solve(b).drive
        return self._psnr(best, wanted) - self._psnr(self._shown(wanted, start), wanted)

    def _psnr(self, drive: FloatArray, wanted: FloatArray) -> float:
        seen = self._transport.apply(drive).reshape(wanted.shape) + self._calibration.ambient
        return psnr(float(np.mean(((seen - wanted)[self._calibration.mask] / WHITE) ** 2)))

    def _shown(self, wanted: FloatArray, start: str) -> FloatArray:
        frame = radiance_frame(wanted)
        room = Room(self._calibration, self.built.maps, WHITE, start=start)
        with headless_renderer("cpu", room) as renderer:
            renderer.open(frame.format)
            renderer.upload(frame)
            renderer.render("projector", compensate=True, steps=STEPS)
            return np.asarray(renderer.linear(), np.float64).reshape(-1, 3)

    def grey(self) -> dict[str, float]:
        """Returns the audience's error of grey in code values: per side of the wall, the worst channel's median."""
        calibration, transport = self._audience
        drive = self._shown(np.full((*self._calibration.camera.shape, 3), WHITE * GREY), "previous-direct")
        seen = (transport.apply(drive) + calibration.ambient.reshape(-1, 3)).reshape(*CAMERA, 3)
        codes = _srgb(seen / WHITE) - _srgb(np.array(GREY))
        medians = {name: np.median(codes[side & calibration.mask], axis=0) for name, side in self._sides.items()}
        return {name: float(each[np.abs(each).argmax()]) for name, each in medians.items()}


def _srgb(light: FloatArray) -> FloatArray:
    grid = np.linspace(0, 1, 4096)
    return np.asarray(np.interp(light, Response("srgb").to_linear(grid), 255 * grid))


def _sides(wall: Wall) -> dict[str, FloatArray]:
    """Returns masks of the audience's pixels: seen by the first camera alone, by both, and by the second alone."""
    size = np.array(CAMERA[::-1])
    first, second = (
        ((looks := looks_at(wall.audience.views[0], view)) > 1).all(axis=2) & (looks < size - 1).all(axis=2)
        for view in wall.scene.views
    )
    return {"first": first & ~second, "both": first & second, "second": second & ~first}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--projectors", type=int, nargs="+", choices=(1, 2), default=[1, 2])
    options = parser.parse_args()
    print(f"| {' | '.join(COLUMNS)} |")
    print("|---" * len(COLUMNS) + "|")
    with TemporaryDirectory() as folder:
        wall = Wall.shipped(Path(folder))
    sides = _sides(wall)
    for projectors in options.projectors:
        views = [wall.seen(view, projectors) for view in wall.scene.views]
        audience = wall.seen(wall.audience.views[0], projectors)
        calibrations, transports = zip(*views, strict=True)
        gains = np.tile(OTHER_LIGHT, (transports[1].shape[0], 1))
        other = brightened(calibrations[1], gains), transports[1].scaled(gains)
        rooms = {f"{projectors}, 1": views[0]}
        for said, second, keep in (
            ("2", views[1], True),
            ("2, exposures matched", other, False),
            ("2, exposures left", other, True),
        ):
            seen, transports = zip(views[0], second, strict=True)
            shared = joined_cameras(seen, transports, "joint", CameraOptions(keep_exposures=keep))
            rooms[f"{projectors}, {said}"] = shared.calibration, shared.transport
        for name, room in rooms.items():
            found = Judged(room, audience, sides)
            off = ", ".join(f"{each:+.2f}" for each in found.grey().values())
            below = ", ".join(f"{found.below_optimum(start):.2f}" for start in ("map", "previous-direct"))
            mib = sum(each.nbytes for each in found.built.maps.named().values()) / 2**20
            print(
                f"| {name} | {room[0].mask.sum()} | {below} dB | {off} | {found.seconds:.0f} s | {mib:.0f} MiB |",
                flush=True,
            )


if __name__ == "__main__":
    main()
