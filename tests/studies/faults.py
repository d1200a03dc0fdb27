"""Faults of real devices in a simulated room, one by one and together: python -m tests.studies.faults.

Each fault is added to the scene `corner`, in a small size. The columns are the price that `simulate --explain` states,
the captures of an acquisition that takes each picture once and ignores the fault, and T's error. The error is up
to the exposure, which a camera's curve leaves unknown. Prints docs/tables/faults.md.
"""

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from counterlight.tools.acquisition.acquire import acquire
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.study.worth import priced
from counterlight.tools.transport.transport import Transport

SIZES = {"projector": (80, 45), "camera": (96, 54)}
DRIVES = 64  # random pictures that compare two transports
FAULTS = {
    "lateral_colour": (
        "projector",
        "lateral_colour = { shift = [[1.1, 0.4], [0, 0], [-0.9, -0.3]], scale = [1.003, 1, 0.998] }",
    ),
    "halo": ("projector", "halo = { share = 0.07, radius_deg = 1 }"),
    "colour_processing": ("projector", "vividness = [0.25, 0.2, 0.15]"),
    "wander": ("camera", "wander = 0.025"),
    "camera_curve": ("camera", 'response = "srgb"\nsensor = { bits = 8 }'),
}


def main() -> None:
    argparse.ArgumentParser(prog="python -m tests.studies.faults", description=__doc__).parse_args()
    print("| fault | CPU s | entries | energy | dB | captures | error of T |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1):
        for names in ((), *((name,) for name in FAULTS), tuple(FAULTS)):
            print(f"| {row(Path(folder) / 'corner.toml', names)} |", flush=True)


def row(path: Path, names: tuple[str, ...]) -> str:
    path.write_text(described(names), encoding="utf-8")
    scene = load_scene(path)
    price = "| | |" if len(names) != 1 else price_of(path, names[0])
    (room,) = simulated_rooms(path)
    camera = SimulatedCamera(room, CameraSettings(scene.camera.sensor or Sensor(), known=False))
    done = acquire(camera, MemoryStore(camera.exposures, averaged=False), HierarchicalScheme(), room.projectors)[0]
    error = f"{100 * error_of(done.measured.transport, room.transport):.1f} %"
    name = names[0] if len(names) == 1 else "all" if names else "none"
    return " | ".join((name, price, f"{done.exposures}", error))


def described(names: tuple[str, ...]) -> str:
    """Returns the scene `corner` in a small size, with some faults."""
    text = shipped_scenes()["corner"].read_text(encoding="utf-8")
    for device, (width, height) in SIZES.items():
        lines = "\n".join(line for name, (where, line) in FAULTS.items() if name in names and where == device)
        head = rf"(\[{device}\]\n)width = \d+\nheight = \d+\n"
        text = re.sub(head, rf"\1width = {width}\nheight = {height}\n{lines}\n", text)
    return text


def price_of(path: Path, name: str) -> str:
    scene = load_scene(path)
    reports = simulate(scene, priced(scene, needs_of(scene))).reports
    (found,) = (each for each in reports if each.need.effect == name)
    worth = "" if found.need.worth is None else f"{found.need.worth:.1f}"
    return f"{found.seconds:.2f} | {found.entries:,} | ~{100 * found.energy_share:.1f} % | {worth}".rstrip()


def error_of(found: Transport, truth: Transport) -> float:
    """Returns the least ‖a T − T₀‖ / ‖T₀‖ of any exposure a; random signs estimate the norms."""
    drives = np.random.default_rng(1).choice((-1.0, 1.0), (DRIVES, truth.shape[1], 3))
    seen, true = (np.stack([T.apply(drive) for drive in drives]) for T in (found, truth))
    exposure = np.vdot(seen, true) / np.vdot(seen, seen)
    return float(np.linalg.norm(exposure * seen - true) / np.linalg.norm(true))


if __name__ == "__main__":
    main()
