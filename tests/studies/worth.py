"""Accuracy of `counterlight simulate --within`: python -m tests.studies.worth [--width 160] [--rooms 6].

Shipped scenes and random rooms are simulated whole and with the effects that a tolerance calls for, at a size that was
not judged. The error of the reduced room is the larger of two: the loss of its drive in the whole room, and the error
of its predicted PSNR. The worst picture counts. All of it is simulated; seconds are of one processor.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import counterlight as cl
from counterlight.arrays import FloatArray
from counterlight.pipeline.content import psnr
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import Simulated, simulate
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.study.worth import priced

PICTURES = ("photograph", "text", "film", "dark-film")


def main() -> None:
    options = _parser().parse_args()
    print("| scene | camera | off | off by, dB | CPU s whole, with these |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for scene in _scenes(options, Path(folder)):
            print(_row(scene, options.within), flush=True)


def _scenes(options: argparse.Namespace, folder: Path) -> Iterator[Scene]:
    shipped = shipped_scenes()
    paths = [path for name, path in shipped.items() if name in options.scenes or not options.scenes]
    for path in [*paths, *(_random_room(folder, seed) for seed in range(options.seed, options.seed + options.rooms))]:
        scene = load_scene(path)
        scale = options.width / scene.camera.width
        sizes = (
            (round(scale * device.height), round(scale * device.width)) for device in (scene.camera, scene.projector)
        )
        yield scene.resized(*sizes)


def _row(scene: Scene, within: float) -> str:
    needs = priced(scene, needs_of(scene), within)
    whole, lacking = simulate(scene), simulate(scene, needs)
    off = [f"{name} {need.worth:.2f}" for name, need in needs.items() if not need.on and need.worth is not None]
    worst = _off_by(_room(scene, whole), _room(scene, lacking)) if off else 0.0
    size = f"{scene.camera.width}x{scene.camera.height}"
    seconds = f"{whole.cpu_seconds:.1f}, {lacking.cpu_seconds:.1f}"
    return f"| {scene.name} | {size} | {', '.join(off) or '–'} | {worst:.3f} | {seconds} |"


def _room(scene: Scene, result: Simulated) -> cl.Room:
    return cl.Room(simulated_calibration(scene, result), result.transport)


def _off_by(whole: cl.Room, lacking: cl.Room) -> float:
    worst = 0.0
    for name in PICTURES:
        picture = BUILT_IN[name](whole.camera)

        def seen(room: cl.Room, drive: FloatArray, picture: FloatArray = picture) -> float:
            return psnr(float(np.mean((room.seen(drive) / whole.white - picture)[whole.mask] ** 2)))

        best, drive = (cl.solve(room, picture, white=whole.white).drive for room in (whole, lacking))
        reached = seen(whole, best)
        worst = max(worst, reached - seen(whole, drive), abs(seen(lacking, drive) - reached))
    return worst


def _random_room(folder: Path, seed: int) -> Path:
    """Write a wall, a floor, and cards and balls of random materials before them; lenses have random focus."""
    rng = np.random.default_rng(seed)
    path = folder / f"room{seed}.toml"
    lens = f"aperture = {rng.choice([0, 0.002, 0.01, 0.03]):g}\nfocus_distance = {rng.uniform(1.8, 2.4):.3f}\n"
    devices = (
        f"[projector]\nwidth = 320\nheight = 240\nposition = [{rng.uniform(-0.4, 0.4):.2f}, 0.3, 2.1]\n"
        f"look_at = [0, 0, 0.1]\nhorizontal_field_of_view_deg = 34\nblack_level = 0.002\n{lens}"
        "[camera]\nwidth = 480\nheight = 360\nposition = [-0.1, 0.2, 2.2]\nlook_at = [0, 0, 0.1]\n"
        f"horizontal_field_of_view_deg = 28\n{_bloom(rng)}[ambient]\nirradiance = [0.02, 0.02, 0.02]\n"
    )
    wall = _surface([-1, -0.4, 0], "edge_u = [2, 0, 0]\nedge_v = [0, 1.5, 0]", _matt(rng))
    floor = _surface([-1, -0.4, 0], "edge_u = [2, 0, 0]\nedge_v = [0, 0, 1]", _matt(rng))
    things = [_thing(rng) for _ in range(rng.integers(1, 4))]
    path.write_text(f'name = "room{seed}"\ncells = 400\n' + "\n".join([devices, wall, floor, *things]))
    return path


def _bloom(rng: np.random.Generator) -> str:
    return "bloom = { share = 0.01, radius_deg = 0.5 }\n" if rng.random() < 0.3 else ""


def _thing(rng: np.random.Generator) -> str:
    x, z, size = rng.uniform(-0.4, 0.3), rng.uniform(0.15, 0.4), rng.uniform(0.1, 0.3)
    if rng.random() < 0.3:
        index, abbe = rng.uniform(1.05, 1.6), rng.uniform(25, 80)
        clear = f"dielectric = {{ index = {index:.2f}, abbe = {abbe:.0f} }}"
        return f'[[surfaces]]\nshape = "sphere"\ncentre = [{x:.2f}, 0, {z:.2f}]\nradius = {size / 2:.2f}\n{clear}\n'
    coat = (
        f"gloss = {{ reflectance = {10 ** rng.uniform(-3.5, -0.5):.5f}, roughness = {rng.uniform(0.05, 0.6):.2f} }}\n"
        if rng.random() < 0.5
        else f"translucency = {{ mean_free_path = [{', '.join([f'{10 ** rng.uniform(-4, -2):.5f}'] * 3)}] }}\n"
    )
    turned = rng.uniform(-1, 1)
    edges = f"edge_u = [{size:.2f}, 0, {turned * size:.2f}]\nedge_v = [0, {size:.2f}, 0]"
    return _surface([x, -0.2, z], edges, _matt(rng) + coat)


def _matt(rng: np.random.Generator) -> str:
    return f"albedo = [{', '.join(f'{value:.2f}' for value in rng.uniform(0.1, 0.85, 3))}]\n"


def _surface(corner: list[float], edges: str, material: str) -> str:
    place = ", ".join(f"{value:.2f}" for value in corner)
    return f"[[surfaces]]\ncorner = [{place}]\n{edges}\n{material}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m tests.studies.worth", description=__doc__)
    parser.add_argument("--within", type=float, default=0.1, metavar="DB")
    parser.add_argument("--width", type=int, default=160, help="width of the cameras; projectors are scaled, too")
    parser.add_argument("--scenes", nargs="*", default=[], help="shipped scenes to simulate (default all)")
    parser.add_argument("--rooms", type=int, default=6, help="number of random rooms (default 6)")
    parser.add_argument("--seed", type=int, default=0)
    return parser


if __name__ == "__main__":
    main()
