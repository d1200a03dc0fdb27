"""Viewers that move: python -m tests.studies.viewpoints [--price] (docs/viewpoints.md).

The rooms are shipped scenes, small. The simulator computes the truth at 11 viewpoints on a line in front of each room,
most of them never calibrated. The figure is how far the shown drive is below the best drive for that viewpoint. Drives
come from 1, 2, 4 and 8 calibrated views, made in several ways. A picture lies on the wall for every viewer. `--price`
prints milliseconds and memory by the number of views.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.files.picture_files import write_png
from counterlight.media.video import Frame
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.content import psnr as decibels
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.fitting import on_cameras
from counterlight.pipeline.room import Room
from counterlight.pipeline.views_together import with_shared_darkness
from counterlight.response import Response
from counterlight.screen import Screen
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.joining.cameras import CameraOptions
from counterlight.tools.joining.views import on_shared_screen
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.needs import chosen, needs_of
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, objective_of
from counterlight.tools.transport.transport import Csr, Transport, channel
from counterlight.viewpoints import Places
from tests.rooms import rgb_frame

CAMERA, PROJECTOR = (96, 128), (45, 80)
COUNT = 22  # viewpoints along the line
SETS = {1: [10], 2: [0, 21], 4: [0, 7, 14, 21], 8: [0, 3, 6, 9, 12, 15, 18, 21]}
SEEN = range(1, COUNT, 2)
TO_THE_END, PLAYED = 256, 8  # steps of refinement: to convergence, and as played
WHITE_ERROR = 60  # error, in code values, that is drawn white
ROUGH = "gloss = { reflectance = 0.06, roughness = 0.35 }"


@dataclass(frozen=True)
class Subject:
    """A shipped scene.

    Light between surfaces is left out: it hardly depends on the viewer, and makes every T dense.

    span : metres to either side of its camera.
    added : TOML added to its first surface.
    """

    scene: str
    what: str
    span: float
    white: float
    added: str = ""


SUBJECTS = {
    "gloss": Subject("wall", "a glossy brick wall", 0.5, 0.35, ROUGH),
    "relief": Subject("statuette", "a bust before a wall", 0.4, 0.3),
    "glass": Subject("glass", "a wine glass before wallpaper", 0.15, 0.35),
}


@dataclass(frozen=True)
class Seen:
    """The truth at one viewpoint: the room, its T, and the best drive for it."""

    room: Calibration
    transport: Transport
    wanted: FloatArray
    white: float
    best: FloatArray

    def db(self, drive: FloatArray) -> float:
        """Returns dB of PSNR below the best, over the pixels that the projector lights directly."""
        return self.psnr(self.best) - self.psnr(drive)

    def psnr(self, drive: FloatArray) -> float:
        seen = self.transport.apply(drive).reshape(self.wanted.shape) + self.room.ambient
        return decibels(float(np.mean(((seen - self.wanted)[self.room.mask] / self.white) ** 2)))


class Line:
    """The truth along the line.

    positions : viewpoints' x in metres.
    """

    def __init__(self, subject: Subject, folder: Path) -> None:
        self.positions, self.white = np.linspace(-subject.span, subject.span, COUNT), subject.white
        scene = _scene(subject, folder, self.positions)
        self._codes = np.rint(255 * _srgb(BUILT_IN["photograph"](CAMERA))).astype(np.uint8)
        self._picture = Response("srgb").to_linear(self._codes / 255)
        self._views, self._seen = scene.views, dict[int, Seen]()
        self.frame: Frame = rgb_frame(self._codes)

    def at(self, number: int) -> Seen:
        """Returns the truth at a viewpoint, numbered from 0; simulated on the first call."""
        if number not in self._seen:
            self._seen[number] = self._made(self._views[number], self._views[0])
        return self._seen[number]

    def _made(self, view: Scene, reference: Scene) -> Seen:
        result = simulate(view, chosen(needs_of(view), ["inter_reflection"]))
        room = simulated_calibration(view, result)
        room = replace(room, screen=Screen(CAMERA, (CAMERA,), _looks_at(view, reference)))
        wanted = self.white * on_cameras(self._picture, room)
        b = (wanted - room.ambient).reshape(-1, 3)
        best = Box(objective_of(result.transport, room, DEFAULT_AIMS)).solve(b).drive
        return Seen(room, result.transport, wanted, self.white, best)

    def placed(self, views: Sequence[int]) -> Places:
        return Places(tuple((float(self.positions[view]), 0.0) for view in views))


def _srgb(light: FloatArray) -> FloatArray:
    grid = np.linspace(0, 1, 4096)
    return np.asarray(np.interp(light, Response("srgb").to_linear(grid), grid))


def _scene(subject: Subject, folder: Path, positions: FloatArray) -> Scene:
    text = shipped_scenes()[subject.scene].read_text()
    at = ", ".join(f"[{x:.6g}, 0]" for x in positions)
    path = folder / "room.toml"
    path.write_text(f"{text}{subject.added}\n[viewpoints]\nat = [{at}]\n")
    return load_scene(path).resized(CAMERA, PROJECTOR)


def _looks_at(view: Scene, reference: Scene) -> FloatArray:
    """Returns the position in the reference picture of the wall point behind each pixel, ignoring glass."""
    directions, _ = view.camera.pixel_rays(range(view.camera.height), 1)
    solid = [surface for surface in view.surfaces if surface.material.dielectric is None]
    x, y, _ = reference.camera.project(trace(view.camera.position, directions, solid).point)
    there = np.nan_to_num(np.stack([x, y], axis=-1), nan=-1000.0)
    return there.reshape(view.camera.height, view.camera.width, 2).astype(np.float32)


def set_of(rooms: Sequence[tuple[Calibration, Transport]], places: Places, white: float) -> Room:
    """Returns what the player reads of a set that was built without T⁺."""
    maps = [build_maps(tier_of(*room), InverseOptions(inverse="none")).maps for room in rooms]
    first, *others = (
        Room(room, made, white, "none", "previous-direct")
        for (room, _), made in zip(rooms, with_shared_darkness(maps), strict=True)
    )
    return replace(first, others=tuple(others), places=places)


class Player:
    """A player for a set of views."""

    def __init__(self, room: Room, frame: Frame) -> None:
        self._renderer, self._frame = CpuRenderer(room), frame
        self._renderer.open(frame.format)

    def drive(self, viewpoint: object, steps: int) -> FloatArray:
        self._renderer.open(self._frame.format)  # a cut: nothing is carried over from another viewpoint
        self._renderer.adjust(Adjustments(viewpoint=viewpoint))  # type: ignore[arg-type]
        self._renderer.upload(self._frame)
        self._renderer.render("projector", compensate=True, steps=steps)
        return self._renderer.linear().reshape(-1, 3).astype(np.float64)


def interpolated(line: Line, views: Sequence[int], shares: FloatArray) -> FloatArray:
    """Returns the best drive for Σ λ T and Σ λ e of the surrounding views, row by row of the screen."""
    parts = [(share, line.at(view)) for share, view in zip(shares, views, strict=True) if share > 0]
    onto = [(share, seen, *_onto_screen(seen.room)) for share, seen in parts]
    total = np.sum([share * known for share, _, _, known in onto], axis=0)
    scale = sparse.diags_array(np.divide(1, total, out=np.zeros_like(total), where=total > 0))
    near = [
        Csr(scale @ sum(share * (R @ channel(seen.transport.near, i)) for share, seen, R, _ in onto)) for i in range(3)
    ]
    b = scale @ sum(share * (R @ (seen.wanted - seen.room.ambient).reshape(-1, 3)) for share, seen, R, _ in onto)
    T = Transport.from_matrices([Csr(each.astype(np.float32)) for each in near], camera=CAMERA, projector=PROJECTOR)
    weights = (total > 0).astype(np.float64)
    prior = objective_of(parts[0][1].transport, parts[0][1].room, DEFAULT_AIMS).prior
    return Box(replace(Objective.plain(T.inside(weights > 0)), weights=weights, prior=prior)).solve(np.asarray(b)).drive


def _onto_screen(room: Calibration) -> tuple[Csr, FloatArray]:
    """Returns screen pixels as means of the camera pixels that look there, and which are known, 0 or 1."""
    assert room.screen is not None
    at, counts = room.screen.positions.reshape(-1, 2) - 0.5, room.mask.ravel()
    corner, (height, width) = np.floor(at).astype(np.int64), room.screen.shape
    entries = []
    for offset in np.ndindex(2, 2):
        x, y = (corner + offset).T
        weight = np.prod(1 - np.abs(at - corner - offset), axis=1)
        inside = counts & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        entries.append((weight[inside], y[inside] * width + x[inside], np.flatnonzero(inside)))
    weights, rows, columns = (np.concatenate(each) for each in zip(*entries, strict=True))
    R = sparse.csr_array((weights, (rows, columns)), (height * width, counts.size))
    total = np.asarray(R.sum(axis=1)).ravel()
    known = total > 0.05  # smallest share of a pixel; with less, no camera pixel looks there
    return Csr(sparse.diags_array(np.divide(1, total, out=np.zeros_like(total), where=known)) @ R), known.astype(float)


def own_screen(line: Line, views: Sequence[int]) -> list[tuple[Calibration, Transport]]:
    """Returns the views as `join --at` places them, from T alone. The screen is the first view."""
    rooms, transports = zip(
        *((replace(line.at(view).room, screen=None), line.at(view).transport) for view in views), strict=True
    )
    joined, _ = on_shared_screen(rooms, transports, "set", CameraOptions(keep_exposures=True))
    screens = [room.screen for room, _ in joined if room.screen is not None]
    low = 0.5 - screens[0].positions[0, 0]
    return [
        (replace(room, screen=Screen(CAMERA, (CAMERA,), screen.positions + low)), transport)
        for (room, transport), screen in zip(joined, screens, strict=True)
    ]


def placing_error(line: Line, views: Sequence[int]) -> FloatArray:
    """Returns how far counted pixels are placed from their true places, in pixels of the first view."""
    found = []
    for view, (room, _) in zip(views, own_screen(line, views), strict=True):
        truth = line.at(view).room.screen
        assert room.screen is not None
        assert truth is not None
        found.append(np.linalg.norm(room.screen.positions - truth.positions, axis=2)[room.mask])
    return np.concatenate(found)


def compared(line: Line, count: int) -> dict[str, list[float]]:
    """Returns dB below each viewpoint's best, by the way in which the drive is made."""
    views, best = SETS[count], [line.at(view).best for view in SETS[count]]
    places = line.placed(views)
    exact = [(line.at(view).room, line.at(view).transport) for view in views]
    sets = [exact, own_screen(line, views) if count > 1 else exact]
    geometry, joined = (Player(set_of(rooms, places, line.white), line.frame) for rooms in sets)
    ways: dict[str, Callable[[FloatArray, tuple[float, float]], FloatArray]] = {
        "nearest view": lambda shares, _: best[int(shares.argmax())],
        "drives blended": lambda shares, _: np.einsum("v,vpc->pc", shares, np.stack(best)),
        "T interpolated": lambda shares, _: interpolated(line, views, shares),
        "solved between": lambda _, at: geometry.drive((at,), TO_THE_END),
        f"… as played, {PLAYED} steps": lambda _, at: joined.drive((at,), PLAYED),
        "for all views at once": lambda _, at: geometry.drive("all", TO_THE_END),
    }
    lost: dict[str, list[float]] = {name: [] for name in ways}
    for number in SEEN:
        at = float(line.positions[number]), 0.0
        shares = places.shares((at,))
        for name, made in ways.items():
            lost[name].append(line.at(number).db(made(shares, at)))
    return lost


def company(line: Line, count: int) -> tuple[list[float], list[float]]:
    """Returns the losses of viewers, one per view: with one drive for all, and with the best drive for the first."""
    views = SETS[count]
    rooms = [(line.at(view).room, line.at(view).transport) for view in views]
    together = Player(set_of(rooms, line.placed(views), line.white), line.frame).drive("all", TO_THE_END)
    return [line.at(view).db(together) for view in views], [
        line.at(view).db(line.at(views[0]).best) for view in views[1:]
    ]


def _range(values: Sequence[float]) -> str:
    return f"{np.mean(values):.2f} ({max(values):.2f})"


def errors(name: str) -> None:
    subject = SUBJECTS[name]
    with TemporaryDirectory() as folder:
        line = Line(subject, Path(folder))
    best = [seen.psnr(seen.best) for seen in map(line.at, range(COUNT))]
    print(f"\n{subject.what}, from {-subject.span} to {subject.span} m; best: {min(best):.1f} to {max(best):.1f} dB")
    for count in SETS:
        lost = compared(line, count)
        if count == 1:
            print(f"| views | {' | '.join(lost)} |")
            print("|---" * (len(lost) + 1) + "|")
        print(f"| {count} | {' | '.join(_range(values) for values in lost.values())} |", flush=True)
    print(
        "\n| viewers at once | one drive for all costs each | the best for the first costs the others |\n|---|---|---|"
    )
    for count in [count for count in SETS if count > 1]:
        all_of_them, others = company(line, count)
        print(f"| {count} | {_range(all_of_them)} | {_range(others)} |", flush=True)
    away = placing_error(line, SETS[8])
    print(f"\nplaced {np.median(away):.2f} pixels from where they look (median; 95 %: {np.percentile(away, 95):.2f})")


def picture(name: str, file: Path) -> None:
    """Draw errors midway between two views: nearest view, blended drives, drive solved there, best drive."""
    with TemporaryDirectory() as folder:
        line = Line(SUBJECTS[name], Path(folder))
    views, seen = SETS[2], line.at(COUNT // 2)
    places, at = line.placed(views), (float(line.positions[COUNT // 2]), 0.0)
    shares, best = places.shares((at,)), [line.at(view).best for view in views]
    player = Player(set_of([(line.at(v).room, line.at(v).transport) for v in views], places, line.white), line.frame)
    blended = np.einsum("v,vpc->pc", shares, np.stack(best))
    drives = best[int(shares.argmax())], blended, player.drive((at,), TO_THE_END), seen.best
    errors = [_error_codes(seen, drive) for drive in drives]
    large = [np.kron(each, np.ones((2, 2))) for each in errors]
    write_png(file, np.rint(np.clip(255 * np.concatenate(large, axis=1) / WHITE_ERROR, 0, 255)).astype(np.uint8))


def _error_codes(seen: Seen, drive: FloatArray) -> FloatArray:
    """Returns the channels' mean absolute error in code values, (height, width); 0 where no pixel counts."""
    found = seen.transport.apply(drive).reshape(seen.wanted.shape) + seen.room.ambient
    codes = [255 * _srgb(np.clip(light / seen.white, 0, 1)) for light in (found, seen.wanted)]
    return np.asarray(np.abs(codes[0] - codes[1]).mean(axis=2) * seen.room.mask)


PRICED = (240, 320), (144, 256)
FRAMES, MIB = 12, 2**20


def price() -> None:
    """Print processor time per frame of the CPU renderer, and its memory, by the number of views."""
    path = shipped_scenes()["wall"]
    scene = load_scene(path).resized(*PRICED)
    result = simulate(scene)
    room = simulated_calibration(scene, result)
    shape = PRICED[0]
    across, down = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    placed = replace(room, screen=Screen(shape, (shape,), np.stack([across, down], axis=-1).astype(np.float32)))
    one = set_of([(placed, result.transport)], Places(((0, 0),)), 0.35)
    frame = rgb_frame(np.rint(255 * BUILT_IN["photograph"](shape)).astype(np.uint8))
    print("| views | maps | frame at a view | between two | moving | for all |\n|---|---|---|---|---|---|")
    for count in SETS:
        views = replace(one, others=(one,) * (count - 1), places=Places(tuple((float(x), 0.0) for x in range(count))))
        maps = count * sum(each.nbytes for each in one.maps.named().values()) / MIB
        last = float(count - 1)
        took = [
            _milliseconds(views, frame, places)
            for places in (
                [((0.0, 0.0),)] * FRAMES,
                [((0.5 * min(last, 1), 0.0),)] * FRAMES,
                [((x * min(last, 1), 0.0),) for x in np.linspace(0.2, 0.8, FRAMES)],
                ["all"] * FRAMES,
            )
        ]
        print(f"| {count} | {maps:.0f} MiB | {' | '.join(f'{ms:.0f} ms' for ms in took)} |", flush=True)


def _milliseconds(room: Room, frame: Frame, places: Sequence[object]) -> float:
    """Returns the median processor time of a frame and of the change of viewpoint before it."""
    renderer, took = CpuRenderer(room), []
    renderer.open(frame.format)
    for place in [places[0], *places]:
        start = time.process_time()
        renderer.adjust(Adjustments(viewpoint=place))  # type: ignore[arg-type]
        renderer.upload(frame)
        renderer.render("projector", compensate=True, steps=PLAYED)
        took.append(1000 * (time.process_time() - start))
    return float(np.median(took[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", nargs="+", choices=SUBJECTS, default=list(SUBJECTS))
    parser.add_argument("--price", action="store_true", help="print only milliseconds and memory")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw only the errors of the first scene")
    options = parser.parse_args()
    if options.price:
        price()
        return
    if options.picture is not None:
        picture(options.scene[0], options.picture)
        return
    for name in options.scene:
        errors(name)


if __name__ == "__main__":
    main()
