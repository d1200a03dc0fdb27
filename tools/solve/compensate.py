"""A calibration and a picture -> the drive that each solver finds, and what the camera then sees."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight import exr, reference
from counterlight.calibration import RADIANCE, StoredCalibration
from counterlight.content import reachable_white
from counterlight.errors import InputError
from counterlight.maps import read_maps
from counterlight.png import write_png
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.relighting.pictures import SUFFIXES, read_placed
from counterlight.tools.relighting.views import inverse_dual
from counterlight.tools.solve.quality import Quality, measure
from counterlight.tools.solve.registry import solve_channels
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem, channel_system
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import CHANNELS
from counterlight.writing.outputs import check_file
from counterlight.writing.replacing import replacing_file

FloatArray = NDArray[np.float64]
METHODS = ("none", "direct", "map", "qr", "svd", "nnls", "box")
FAR_ROUNDS = 20
FAR_TOLERANCE = 0.1 / 255  # drive
HEADER = "solver       RMSE %  PSNR dB   SSIM  CIEDE2000  clipped %  seconds  below the optimum dB"


@dataclass(frozen=True)
class CompensateOptions:
    """How to solve.

    solvers : of METHODS.
    max_cluster : for qr, svd and nnls, decompose T into clusters of at most so many projector pixels (thesis 4.2.2).
    white : radiance of a white picture, None for what most of the room can reach.
    """

    solvers: tuple[str, ...]
    max_cluster: int | None = None
    white: float | None = None

    def __post_init__(self) -> None:
        if self.white is not None and not RADIANCE[0] <= self.white <= RADIANCE[1]:
            raise InputError(f"--white {self.white:g}: expected a radiance from {RADIANCE[0]:g} to {RADIANCE[1]:g}")
        for name in self.solvers:
            if name not in METHODS:
                raise InputError(f"--solver {name}: expected all or some of {', '.join(METHODS)}, joined by commas")


@dataclass(frozen=True)
class Compensated:
    """What one solver did.

    drive : (projector height, projector width, 3), 0..1.  clipped : share of the lit projector pixels' values that
    the solver asked for beyond 0..1.  below_optimum : decibels that the box optimum's PSNR is above this one's.
    """

    solver: str
    drive: FloatArray
    quality: Quality
    clipped: float
    seconds: float
    below_optimum: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        q = self.quality
        return (
            f"{self.solver:10} {100 * q.rmse:8.3f} {q.psnr:8.2f} {q.ssim:6.4f} {q.ciede2000:10.3f} "
            f"{100 * self.clipped:10.2f} {self.seconds:8.2f} {self.below_optimum:21.3f}"
        )


class CompensationTask:
    """One picture in one room; see `run`."""

    def __init__(self, stored: StoredCalibration, picture: FloatArray, *, radiance: bool, options: CompensateOptions):
        """picture : (camera height, camera width, 3), linear 0..1, or the desired radiance itself."""
        self._stored, self._options = stored, options
        self._transport = read_transport(stored)
        calibration = self._calibration = stored.calibration
        flood = self._picture(self._transport.composition()) + calibration.ambient
        self.white = reachable_white(flood, calibration.mask) if options.white is None else options.white
        self._desired = picture if radiance else picture * self.white
        self._target = np.asarray(self._desired - calibration.ambient, np.float64).reshape(-1, 3)
        mask = calibration.mask.ravel()
        self._systems = [channel_system(self._transport, i, self._target[:, i], mask) for i in range(3)]
        self._lit = np.stack([np.diff(system.near.tocsc().indptr) > 0 for system in self._systems], axis=1)

    def run(self, plain: FloatArray) -> Iterator[Compensated]:
        """Every solver of the options, in their order.

        plain : (projector height, projector width, 3), the picture as the projector would show it uncorrected.
        """
        for name in self._options.solvers:
            if name == "box":
                yield self._optimum
            else:
                start = time.perf_counter()
                unclamped, notes = self._solve(name, plain)
                yield self._judge(name, unclamped, time.perf_counter() - start, notes, self._optimum.quality.psnr)

    @cached_property
    def _optimum(self) -> Compensated:
        start = time.perf_counter()
        unclamped, notes = _joined(solve_channels("box", self._systems))
        found = self._judge("box", unclamped, time.perf_counter() - start, notes, float("nan"))
        return replace(found, below_optimum=0.0)

    def _solve(self, name: str, plain: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        if name == "none":
            return plain.reshape(-1, 3), ()
        if name == "map":
            drive = inverse_dual(read_maps(self._stored), self._picture(self._target))
            return drive.reshape(-1, 3), ()
        if self._options.max_cluster is None or name == "direct":
            return _joined(solve_channels(name, self._systems))
        return self._solve_decomposed(name, self._options.max_cluster)

    def _solve_decomposed(self, name: str, max_cluster: int) -> tuple[FloatArray, tuple[str, ...]]:
        """Clusters of the near light; far light is that of the clamped drive, until the drive stops changing."""
        shapes = self._calibration.camera.shape, self._calibration.projector.shape
        nears = tuple(system.near for system in self._systems)
        parameters, cut = decompose_to(nears, *shapes, max_cluster)
        note = f"T cut to clusters of at most {max_cluster} (radius {parameters.radius:g}, τ₁ {parameters.tau_1:g})"
        drives, far_notes = np.zeros(self._lit.shape), list[str]()
        for rounds in range(1, FAR_ROUNDS + 1):
            reduced = [
                LinearSystem(near, system.target - system.apply(p) + system.near @ p)
                for near, system, p in zip(cut.matrices, self._systems, np.clip(drives, 0, 1).T, strict=True)
            ]
            before = drives
            drives, notes = _joined(solve_channels(name, reduced))
            change = float(np.max(np.abs(np.clip(drives, 0, 1) - np.clip(before, 0, 1)), initial=0.0))
            if self._transport.far is None:
                break
            far_notes = [f"far light from the clamped drive, {rounds} rounds, last change {255 * change:.2f} codes"]
            if change <= FAR_TOLERANCE:
                break
        return drives, (note, *far_notes, *notes)

    def _judge(
        self, name: str, unclamped: FloatArray, seconds: float, notes: tuple[str, ...], best: float
    ) -> Compensated:
        drive = np.clip(unclamped, 0, 1)
        seen = self._picture(self._transport.apply(drive)) + self._calibration.ambient
        quality = measure(self._desired, seen, self._calibration.mask, self.white)
        beyond = np.abs(unclamped - drive) > FAR_TOLERANCE
        clipped = float(np.mean(beyond[self._lit])) if self._lit.any() else 0.0
        shape = *self._calibration.projector.shape, 3
        return Compensated(name, drive.reshape(shape), quality, clipped, seconds, best - quality.psnr, notes)

    def _picture(self, light: FloatArray) -> FloatArray:
        return light.reshape(*self._calibration.camera.shape, 3)


def compensate(folder: Path, picture: Path, output: Path | None, options: CompensateOptions) -> Iterator[str]:
    """Solve, write what was asked for and yield what to print, line by line.

    output : .png holds the projector's code values, .exr the linear drive; with several solvers the name of each is put
    before the suffix. None writes nothing.
    """
    outputs = {} if output is None else _outputs(output, options.solvers)
    for path in outputs.values():
        check_file(path, suffixes=SUFFIXES, inputs=[picture])
    stored = calibrations.read(folder)
    calibration, radiance = stored.calibration, picture.suffix.lower() == ".exr"
    wanted = read_placed(picture, calibration.camera.shape)
    task = CompensationTask(stored, wanted, radiance=radiance, options=options)
    plain = _uncorrected(picture, wanted, radiance, calibration.projector.shape, task.white)
    yield f"white is a camera radiance of {task.white:.4g}; {int(calibration.mask.sum())} camera pixels count"
    yield HEADER
    for found in task.run(plain):
        if found.solver in outputs:
            _write(outputs[found.solver], found.drive, calibration.projector.response.inverse_table())
        yield str(found)
        yield from (f"    {note}" for note in found.notes)
    yield from (f"{path}: written" for path in outputs.values())


def _uncorrected(path: Path, wanted: FloatArray, radiance: bool, shape: tuple[int, int], white: float) -> FloatArray:
    """The picture as drive: fitted into the projector's frame, or radiance of the camera's frame stretched over it."""
    if not radiance:
        return read_placed(path, shape)
    return np.asarray(reference.resample(wanted / white, shape, (0, 0, shape[1], shape[0])), np.float64)


def _joined(channels: list[Solution]) -> tuple[FloatArray, tuple[str, ...]]:
    """The drive (projector pixels, 3), and the notes with their colours before them."""
    notes = tuple(f"{name}: {note}" for name, found in zip(CHANNELS, channels, strict=True) for note in found.notes)
    return np.stack([found.unclamped for found in channels], axis=1), notes


def _outputs(path: Path, solvers: tuple[str, ...]) -> dict[str, Path]:
    if len(solvers) == 1:
        return {solvers[0]: path}
    return {name: path.with_name(f"{path.stem}-{name}{path.suffix}") for name in solvers}


def _write(path: Path, drive: FloatArray, inverse_response: NDArray[np.float32]) -> None:
    with replacing_file(path) as temporary:
        if path.suffix.lower() == ".exr":
            exr.write_rgb(temporary, drive.astype(np.float32))
        else:
            write_png(temporary, reference.encode(drive, inverse_response))
