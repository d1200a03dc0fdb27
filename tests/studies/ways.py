"""The way of light in shipped rooms, from T alone: python -m tests.studies.ways [PICTURE.png] (docs/ways.md).

The picture shows each room under full light and its pixels by the way of their light. The table states how much of the
wax, of the glass (seen through it) and of the card out of focus is recognised, and how much elsewhere.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from counterlight.arrays import BoolArray
from counterlight.files.picture_files import write_png
from counterlight.tools.relighting.pictures import encoded, white_level
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.ways.ways import BENT, BLURRED, BOUNCED, SCATTERED, WAYS, Way, Ways, ways_of

CAMERA, PROJECTOR = (72, 96), (72, 96)
ROOMS = {  # name of a room: its way, and the number of the surface with it; None for all surfaces
    "wall": (BOUNCED, None),
    "corner": (BOUNCED, None),
    "skull": (SCATTERED, 1),
    "glass": (BENT, 1),
    "two_planes": (BLURRED, 1),
}
OPEN = "aperture = 0.05", "aperture = 0.2"  # change of two_planes, which is nearly sharp at this size as shipped


def scene_of(name: str, folder: Path) -> Scene:
    (folder / f"{name}.toml").write_text(shipped_scenes()[name].read_text().replace(*OPEN))
    return load_scene(folder / f"{name}.toml").resized(CAMERA, PROJECTOR)


def surface(scene: Scene, number: int | None) -> BoolArray:
    """Returns the camera pixels that see a surface."""
    directions, _ = scene.camera.pixel_rays(range(CAMERA[0]), 1)
    hit = trace(scene.camera.position, directions, scene.surfaces).surface.reshape(CAMERA)
    return np.asarray(hit >= 0 if number is None else hit == number)


def row(name: str, ways: Ways, way: Way, where: BoolArray) -> str:
    found = ways.first == 1 + WAYS.index(way)
    of, beside = (100 * np.mean(found[each & ways.lit]) if (each & ways.lit).any() else 0.0 for each in (where, ~where))
    others = 100 * np.mean((ways.first > 0) & ~found)
    share = 100 * np.mean(ways.shares[WAYS.index(way)][ways.lit])
    return f"| `{name}` | {way.name} | {of:.0f} % | {beside:.0f} % | {others:.0f} % | {share:.0f} % |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, nargs="?", help="draw the rooms, and their ways below, into this PNG")
    options = parser.parse_args()
    print("| room | way | of its surface | elsewhere | another way | of all light |\n|---|---|---|---|---|---|")
    drawn = []
    with tempfile.TemporaryDirectory() as folder:
        for name, (way, number) in ROOMS.items():
            scene = scene_of(name, Path(folder))
            result = simulate(scene)
            room = simulated_calibration(scene, result)
            ways = ways_of(room, result.transport)
            print(row(name, ways, way, surface(scene, number)), flush=True)
            light = result.transport.floodlight(room.ambient)
            both = np.vstack([encoded(light, white_level(light)), ways.picture()])
            drawn.append(cv2.resize(both, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST))
    if options.picture is not None:
        write_png(options.picture, np.hstack(drawn))


if __name__ == "__main__":
    main()
