"""True and estimated distance of pictures from the best picture: python -m tests.studies.standing [ROOM …]

Prints docs/tables/standing.md for calibration folders with their maps, or for the shipped scenes at half their
size, which are simulated and built first. The truth is by the box solver to a relative gap of 1e-5, in Σ w (T p − b)².
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from counterlight import calibration
from counterlight.pipeline.room import read_room
from counterlight.pipeline.survey import Survey
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from tests.programs import succeed
from tests.renderers import drawn

PICTURES = ("photograph", "text")
DRAWN = (("map", 0), ("previous", 1), ("previous", 4), ("previous-direct", 4), ("previous-direct", 8), ("previous", 16))
TOLERANCE = 1e-5


def rows(folder: Path) -> Iterator[tuple[str, str, int, float, float, float, str]]:
    """Yield picture, start, steps, true, estimated and certified dB below the optimum, and the squares solved."""
    room, stored = read_room(folder, None), calibration.read(folder)
    objective = objective_of(read_transport(stored), stored.calibration, DEFAULT_AIMS).unweighted
    assert room.maps.refinement is not None
    box, survey = Box(objective, tolerance=TOLERANCE), Survey(room)
    for picture in find_pictures(PICTURES):
        radiance = (room.white * picture.at(stored.calibration.camera.shape)).astype(np.float32)
        b = (radiance - room.ambient).reshape(-1, 3).astype(np.float64)
        least = objective.certificate(box.solve(b).drive, b).squared_error.sum()
        for start, steps in DRAWN:
            found, _ = drawn(room, radiance, start, steps)
            error = objective.certificate(found.drive.reshape(-1, 3).astype(float), b).squared_error.sum()
            estimate = survey.of(found)
            truth, bound = 10 * np.log10(error / least), found.certificate.decibels
            solved = f"{estimate.solved} of {estimate.squares}"
            yield picture.name, start, steps, truth, estimate.decibels, bound, solved


def main() -> None:
    print("| room, picture | start, steps | in truth | estimated | squares | certified |\n" + "|---" * 6 + "|")
    with TemporaryDirectory() as made:
        for folder in map(Path, sys.argv[1:]) if sys.argv[1:] else shipped(Path(made)):
            for picture, start, steps, truth, estimate, bound, solved in rows(folder):
                figures = f"{truth:.4f} | {estimate:.4f} | {solved} | {bound:.2g}"
                print(f"| {folder.name}, {picture} | {start}, {steps} | {figures} |", flush=True)


def shipped(folder: Path) -> Iterator[Path]:
    """Yield the shipped scenes at half their size, built by the commands."""
    for name, path in shipped_scenes().items():
        scene = load_scene(path)
        camera, projector = (f"{device.width // 2}x{device.height // 2}" for device in (scene.camera, scene.projector))
        succeed("simulate", name, "-o", folder / name, "--camera", camera, "--projector", projector)
        succeed("build", folder / name)
        yield folder / name


if __name__ == "__main__":
    main()
