"""Benefit of refinement: python -m tests.studies.refinement prints docs/tables/refinement.md.

The rooms are simulated: scenes of calib_data/scenes (projector 256x144, camera 320x180) and a textured wall out of
focus (128x96, 160x120, σ of one projector pixel). The pictures are frames of the shipped clip. The optimum is by the
box solver of tools/solve; figures are decibels of camera PSNR below it. Drives and milliseconds are the GPU player's.
On llvmpipe they are processor time over all cores, which other load on the machine hardly changes.
"""

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, Device, writing
from counterlight.gl.context import headless_context
from counterlight.gl.renderer import GlRenderer
from counterlight.maps import room_maps as maps
from counterlight.maps.prior import Prior
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.refinement import OVER_RELAXATION, STARTS, momentum
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.shipped import CLIP
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.mask import lit_pixels
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport
from tests.bench.frames import clock_of
from tests.oracles.formulas import refinement_step
from tests.scenes import small

PROJECTOR, CAMERA = (144, 256), (180, 320)
BLURRED_PROJECTOR, BLURRED_CAMERA, BLUR, REACH = (96, 128), (120, 160), 1.0, 4
STEPS = (1, 2, 4, 8, 16, 32, 64)
STILL_AT_S, FILM_FROM_S, FILM_FRAMES, FILM_STEPS = 1.0, 1.0, 8, (1, 2, 4, 8)
REPEATS, MANY = 9, 17
TOLERANCE = 1e-3  # relative gap, 0.004 dB
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class StudyRoom:
    name: str
    room: Room
    transport: Transport

    def best(self, b: FloatArray) -> FloatArray:
        """Returns the optimal drive of the box solver.

        b : (camera pixels, 3).
        """
        mask = self.room.calibration.mask.ravel()
        return Box(self.transport.inside(mask), 1.0, TOLERANCE).solve(b * mask[:, None]).drive

    def psnr(self, drive: FloatArray, b: FloatArray) -> float:
        mask = self.room.calibration.mask.ravel()
        return camera_psnr(b, self.transport.apply(drive), mask, self.room.white)


def rooms(folder: Path) -> Iterator[StudyRoom]:
    for name in ("wall", "corner", "two_planes"):
        simulated = simulate(small(name, CAMERA, PROJECTOR))
        lit = Transport(simulated.transport.near).composition().reshape(*CAMERA, 3)
        mask = lit_pixels(lit, simulated.ambient)
        yield _built(folder / name, simulated.transport, simulated.ambient, PROJECTOR, mask)
    ambient = np.full((*BLURRED_CAMERA, 3), 0.01, np.float32)
    yield _built(folder / "out of focus", defocused(), ambient, BLURRED_PROJECTOR, np.ones(BLURRED_CAMERA, np.bool_))


def defocused() -> Transport:
    """Returns a wall of smooth random colours out of focus: a Gaussian around each camera pixel's place."""
    (height, width), (rows, columns) = BLURRED_PROJECTOR, BLURRED_CAMERA
    y, x = np.mgrid[:rows, :columns].reshape(2, -1, 1)
    down, right = (y + 0.5) * height / rows - 0.5, (x + 0.5) * width / columns - 0.5
    offset = np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1].reshape(2, 1, -1)
    v, u = np.round(down).astype(int) + offset[0], np.round(right).astype(int) + offset[1]
    weights = np.exp(-((down - v) ** 2 + (right - u) ** 2) / (2 * BLUR**2))
    used = (weights > 0.01) & (v >= 0) & (v < height) & (u >= 0) & (u < width)
    weights = np.where(used, weights, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    at = np.nonzero(used)[0], (v * width + u)[used]
    noise = np.random.default_rng(6).normal(size=(rows, columns, 3))
    colours = cv2.GaussianBlur(noise, (0, 0), 3)
    colours = 0.7 + 0.25 * colours / np.abs(colours).max()
    shape = rows * columns, height * width
    blur = sparse.csr_array((weights[used], at), shape=shape)
    channels = (sparse.diags_array(colours[..., i].ravel()) @ blur for i in range(3))
    return Transport.from_matrices(tuple(sparse.csr_array(T, dtype=np.float32) for T in channels))


def _built(
    folder: Path,
    transport: Transport,
    ambient: NDArray[np.float32],
    projector: tuple[int, int],
    mask: NDArray[np.bool_],
) -> StudyRoom:
    height, width, _ = ambient.shape
    devices = Device(*projector, Response("srgb")), Device(height, width, Response("linear"))
    with writing(folder, Calibration(folder.name, "study", devices[:1], devices[1], ambient, mask)) as stage:
        write_transport(transport, stage)
    stored = calibration.read(folder)
    build_room_maps(stored, InverseOptions(inverse="whole"))
    room_maps = maps.read_maps(stored)
    return StudyRoom(folder.name, Room(stored.calibration, room_maps, room_maps.white), read_transport(stored))


@contextmanager
def renderers(study: StudyRoom, starts: Sequence[str] = STARTS) -> Iterator[dict[str, GlRenderer]]:
    with headless_context() as context:
        made = {start: GlRenderer(context, replace(study.room, start=start)) for start in starts}
        yield made
        for renderer in made.values():
            renderer.release()


def shown(made: dict[str, GlRenderer], from_s: float, count: int) -> Iterator[tuple[int, FloatArray]]:
    """Upload `count` consecutive frames; yields each frame's number and b, (camera pixels, 3)."""
    with MediaReader.open(CLIP) as reader:
        reader.seek(from_s)
        for renderer in made.values():
            renderer.open(reader.info.format)
        for index in range(count):
            frame = reader.next_frame(60.0)
            assert frame is not None
            for renderer in made.values():
                renderer.upload(frame)
            reader.release(frame)
            renderer = next(iter(made.values()))
            ambient = renderer._room.calibration.ambient.reshape(-1, 3)
            yield index, renderer.desired().reshape(-1, 3).astype(float) - ambient


@dataclass(frozen=True)
class Cost:
    """Milliseconds per frame: before its first step, and per step."""

    base: float
    step: float

    def of(self, steps: int) -> float:
        return self.base + steps * self.step

    def steps_within(self, budget: float) -> int:
        return max(int((budget - self.base) / self.step + 1e-6), 0)


def costs(made: dict[str, GlRenderer]) -> dict[str, Cost]:
    """Returns the costs. Every renderer runs REPEATS times, in turns, and its fastest run counts."""
    clock = clock_of(moderngl.get_context())
    fastest = {(start, steps): np.inf for start in made for steps in (1, MANY)}
    for _ in range(REPEATS):
        for start, steps in fastest:
            begin = clock()
            made[start].render("projector", compensate=True, steps=steps)
            made[start].finish()
            fastest[start, steps] = min(fastest[start, steps], 1000 * (clock() - begin))
    step = {start: (fastest[start, MANY] - fastest[start, 1]) / (MANY - 1) for start in made}
    return {start: Cost(fastest[start, 1] - step[start], step[start]) for start in made}


def drive_of(renderer: GlRenderer, steps: int) -> FloatArray:
    renderer.render("projector", compensate=True, steps=steps)
    return renderer.linear().reshape(-1, 3).astype(float)


def still(study: StudyRoom) -> None:
    """Print one picture from every start by steps, certificates, other schedules, and fixed far light."""
    with renderers(study, ("map", "direct", "grey")) as made:
        for _, b in shown(made, STILL_AT_S, 1):
            best = study.psnr(study.best(b), b)
            alone = best - study.psnr(drive_of(made["map"], 0), b)
            print(f"\n**{study.name}**, optimum {best:.2f} dB, T⁺ alone {alone:.2f} dB below; {entries(study)}\n")
            header("start", *map(said, STEPS), "before a step, ms", "a step, ms")
            for start, cost in costs(made).items():
                below = [best - study.psnr(drive_of(made[start], steps), b) for steps in STEPS]
                row(start, *(f"{each:.2f}" for each in below), f"{cost.base:.1f}", f"{cost.step:.2f}")
            row("certified, from map", *(certified(made["map"], steps) for steps in STEPS), "", "")
            schedules(study, drive_of(made["map"], 0), b, best)
            if study.transport.far is not None:
                fixed_far_light(study, drive_of(made["map"], 0), b, best)


def certified(renderer: GlRenderer, steps: int) -> str:
    drive_of(renderer, steps)
    certificate = renderer.certificate()
    assert certificate is not None
    return f"{certificate.decibels:.2g}"


def film(study: StudyRoom) -> None:
    """Print consecutive frames at equal steps, and at equal milliseconds."""
    starts = ("previous", "previous-direct", "map", "direct")
    optima: list[float] = []
    with renderers(study, starts) as made:
        for _, b in shown(made, FILM_FROM_S, FILM_FRAMES):
            optima.append(study.psnr(study.best(b), b))
        cost = costs(made)
        print(f"\n{FILM_FRAMES - 1} frames of film, the mean (the worst):\n")
        header("start", *map(said, FILM_STEPS))
        for start in starts:
            row(start, *(followed(study, made, start, steps, optima) for steps in FILM_STEPS))
        print("\nAt equal milliseconds, with the steps that fit:\n")
        budgets = [cost["previous"].of(steps) for steps in FILM_STEPS]
        header("start", *(f"{budget:.0f} ms" for budget in budgets))
        for start in starts:
            fitting = [cost[start].steps_within(budget) for budget in budgets]
            row(start, *(f"{said(steps)}: {followed(study, made, start, steps, optima)}" for steps in fitting))


def followed(study: StudyRoom, made: dict[str, GlRenderer], start: str, steps: int, optima: Sequence[float]) -> str:
    """Returns the mean (worst) decibels below each frame's optimum, without the first frame."""
    below = [
        optima[index] - study.psnr(drive_of(made[start], steps), b)
        for index, b in shown({start: made[start]}, FILM_FROM_S, FILM_FRAMES)
    ][1:]
    return f"{np.mean(below):.2f} ({max(below):.2f})"


Schedule = Callable[[int, FloatArray, FloatArray, FloatArray], FloatArray]


def descend(study: StudyRoom, p: FloatArray, b: FloatArray, best: float, schedule: Schedule) -> list[float]:
    """Returns decibels below the optimum after each of STEPS steps, computed with numpy.

    schedule : function (step, q, p, y) that returns the next y.
    """
    further = study.room.maps.refinement
    assert further is not None
    size, y, below = further.step_size.reshape(-1, 3).astype(float), p, []
    mask = study.room.calibration.mask.ravel()[:, None]
    for step in range(1, STEPS[-1] + 1):
        descent = study.transport.apply_transpose(mask * (b - study.transport.apply(y)))
        q = np.asarray(plain_step(descent, y, p, size, 0, 0)[0])
        y, p = schedule(step, q, p, y), q
        if step in STEPS:
            below.append(best - study.psnr(p, b))
    return below


def schedules(study: StudyRoom, start: FloatArray, b: FloatArray, best: float) -> None:
    def nesterov(step: int, q: FloatArray, p: FloatArray, y: FloatArray) -> FloatArray:
        return q + step / (step + 3) * (q - p)

    def local(step: int, q: FloatArray, p: FloatArray, y: FloatArray) -> FloatArray:
        return q + np.where((y - q) * (q - p) > 0, 0, 0.95 * (q - p))

    def constant(step: int, q: FloatArray, p: FloatArray, y: FloatArray) -> FloatArray:
        return q + 0.9 * (q - p)

    def ours(step: int, q: FloatArray, p: FloatArray, y: FloatArray) -> FloatArray:
        return q + momentum(step) * (q - p) + OVER_RELAXATION * (q - y)

    class Restarted:
        since = np.zeros(3)

        def __call__(self, step: int, q: FloatArray, p: FloatArray, y: FloatArray) -> FloatArray:
            uphill = np.sum((y - q) * (q - p), axis=0) > 0
            self.since = np.where(uphill, 0, self.since) + 1
            return q + self.since / (self.since + 3) * (q - p)

    print("\nFrom the map by other schedules:\n")
    header("schedule", *map(said, STEPS))
    for name, schedule in {
        "no momentum": lambda step, q, p, y: q,
        "β = n/(n + 3)": nesterov,
        "the same, restarted where the picture goes uphill": Restarted(),
        "β = 0.95, restarted pixel by pixel": local,
        "β = 0.9": constant,
        "β = n/(n + 1) ≤ 0.95, γ = 0.6": ours,
    }.items():
        row(name, *(f"{each:.2f}" for each in descend(study, start, b, best, schedule)))


def plain_step(
    descent: FloatArray, y: FloatArray, p: FloatArray, size: FloatArray, momentum: float, over: float
) -> tuple[FloatArray, FloatArray]:
    """Take the player's step without ties, on (projector pixels, 3)."""
    line = (1, len(y))
    descent, y, p, size = (each.reshape(*line, 3) for each in (descent, y, p, size))
    done = refinement_step(descent, y, p, size, Prior.none(line), momentum, over)
    return np.asarray(done[0]).reshape(-1, 3), np.asarray(done[1]).reshape(-1, 3)


def fixed_far_light(study: StudyRoom, p: FloatArray, b: FloatArray, best: float) -> None:
    """Print the cost and the loss of steps through the near light alone, with the far light of the start."""
    near = replace(study, transport=Transport(study.transport.near))
    further = study.room.maps.refinement
    assert further is not None
    bare = replace(study.room.maps, far=None, undo=None, refinement=replace(further, far_dual=None))
    with renderers(replace(study, room=replace(study.room, maps=bare)), ("map",)) as made:
        for _ in shown(made, STILL_AT_S, 1):
            step = costs(made)["map"].step
    y = p
    seen = b - (study.transport.apply(p) - near.transport.apply(p))
    mask = study.room.calibration.mask.ravel()[:, None]
    d = near.transport.apply_transpose(mask * near.transport.composition())
    size = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0)
    below = []
    for n in range(1, STEPS[-1] + 1):
        descent = near.transport.apply_transpose(mask * (seen - near.transport.apply(y)))
        p, y = map(np.asarray, plain_step(descent, y, p, size, momentum(n), OVER_RELAXATION))
        if n in STEPS:
            below.append(best - study.psnr(p, b))
    print(f"\nFar light kept as it is in the start, {step:.2f} ms a step:\n")
    header("", *map(said, STEPS))
    row("near light alone", *(f"{each:.2f}" for each in below))


def entries(study: StudyRoom) -> str:
    named = study.room.maps.named()
    far = sum(packed.count for name, packed in named.items() if name.startswith("far"))
    return f"entries: T⁺ {named['.'].count}, T {named['transport'].count}" + (f" and {far} of far light" if far else "")


def said(steps: int) -> str:
    return "1 step" if steps == 1 else f"{steps} steps"


def header(*cells: str) -> None:
    row(*cells)
    print("|---" * len(cells) + "|")


def row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    with headless_context() as context:
        print(f"{os.cpu_count()} cores, {context.info['GL_RENDERER']}")
    with tempfile.TemporaryDirectory() as folder:
        for study in rooms(Path(folder)):
            still(study)
            film(study)


if __name__ == "__main__":
    main()
