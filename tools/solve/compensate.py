"""From a calibration and a picture to each solver's drive, and the resulting camera picture."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from counterlight import calibration as calibrations
from counterlight.arrays import FloatArray
from counterlight.calibration import RADIANCE
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.picture_files import write_png
from counterlight.maps.mixing import Mixing
from counterlight.maps.room_maps import RoomMaps, read_maps
from counterlight.passes.encode import encoded, reached
from counterlight.passes.resample import resample
from counterlight.pipeline.operators import drive_of
from counterlight.response import RasterResponse
from counterlight.tools.choices import COMPENSATIONS
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.relighting.pictures import SUFFIXES, read_placed
from counterlight.tools.solve.quality import Quality, measure
from counterlight.tools.solve.registry import Prepared, prepare
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions, objective_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport
from counterlight.writing.outputs import check_file
from counterlight.writing.replacing import replacing_file

FAR_ROUNDS = 20
FAR_TOLERANCE = 0.1 / 255  # change of drive that ends the iteration; a smaller excess over 0..1 is no clipping
HEADER = "solver         RMSE %  PSNR dB   SSIM  CIEDE2000  clipped %  seconds  below the optimum dB  light outside %"


@dataclass(frozen=True)
class CompensateOptions:
    """Options of a compensation.

    solvers : names in COMPENSATIONS.
    max_cluster : for qr, svd and nnls, decompose T into clusters of at most this many projector pixels (thesis 4.2.2).
    white : radiance of a white picture; None for what most of the room can reach.
    colour : one of COLOURS.
    aims : weights and priors of the objective.
    priors : whether the box uses play's objective, with weights and priors; otherwise plain least squares.
    """

    solvers: tuple[str, ...]
    max_cluster: int | None = None
    white: float | None = None
    colour: str = "auto"
    aims: ObjectiveOptions = DEFAULT_AIMS
    priors: bool = False

    def __post_init__(self) -> None:
        if self.white is not None and not RADIANCE[0] <= self.white <= RADIANCE[1]:
            raise InputError(f"--white {self.white:g}: expected a radiance from {RADIANCE[0]:g} to {RADIANCE[1]:g}")
        if self.max_cluster is not None and self.max_cluster < 1:
            raise InputError(f"--max-cluster {self.max_cluster}: expected at least 1 projector pixel")
        for name in self.solvers:
            if name not in COMPENSATIONS:
                raise InputError(f"--solver {name}: expected all, or of {', '.join(COMPENSATIONS)}, joined by commas")


@dataclass(frozen=True)
class Compensated:
    """The result of one solver.

    drive : (projector height, projector width, 3), 0..1.
    clipped : share of the lit projector pixels' values that the solver put outside 0..1, or that no code values give.
    below_optimum : dB by which the unweighted optimum's PSNR is higher.
    outside : light that the camera does not see, relative to the uncorrected picture; None if it sees everything.
    """

    solver: str
    drive: FloatArray
    quality: Quality
    clipped: float
    seconds: float
    below_optimum: float
    notes: tuple[str, ...]
    outside: float | None = None

    def __str__(self) -> str:
        q, outside = self.quality, "-" if self.outside is None else f"{100 * self.outside:.1f}"
        return (
            f"{self.solver:12} {100 * q.rmse:8.3f} {q.psnr:8.2f} {q.ssim:6.4f} {q.ciede2000:10.3f} "
            f"{100 * self.clipped:10.2f} {self.seconds:8.2f} {self.below_optimum:21.3f} "
            f"{outside:>16}"
        )


class CompensationTask:
    """One picture in one room; see `run`."""

    def __init__(
        self,
        tier: Tier,
        picture: FloatArray,
        *,
        radiance: bool,
        options: CompensateOptions,
        maps: RoomMaps | None = None,
    ) -> None:
        """Prepare a task.

        picture : (camera height, camera width, 3). Linear 0..1, or the desired camera radiance itself.
        radiance : whether `picture` is radiance.
        maps : the room's maps, for the solver `map`.
        """
        self._tier, self._calibration, self._options, self._maps = tier, tier.calibration, options, maps
        self.white = tier.white if options.white is None else options.white
        self._wanted, self._radiance = picture, radiance
        self._desired = self._stated(tier.mixing)
        self._target = tier.target(self._desired)
        if options.max_cluster is not None and tier.transport.blurred is not None:
            raise InputError(
                f"--max-cluster {options.max_cluster}: blurred light is kept in blocks of pixels, which cannot be cut "
                "into clusters; leave the option out"
            )
        sizes = tier.calibration.camera.shape, tier.calibration.projector.shape
        self._objective = objective_of(tier.transport, tier.calibration, options.aims, tier.mixing)
        self._counts = self._objective.lit_picture(tier.calibration)
        self._inside = replace(tier.transport.inside(self._counts), camera=sizes[0], projector=sizes[1])
        self._lit = self._inside.lit

    @property
    def counted(self) -> int:
        """Number of lit camera pixels, which are solved for and judged."""
        return int(self._counts.sum())

    def run(self, plain: FloatArray) -> Iterator[Compensated]:
        """Run every solver of the options, in order.

        plain : (projector height, projector width, 3). The uncorrected picture on the projector.
        """
        for name in self._options.solvers:
            found = self._optimum if name == "box" and not self._options.priors else self._found(name, plain)
            drives = (each.reshape(-1, 3) for each in (found.drive, plain))
            yield replace(found, outside=self._objective.light_outside(*drives))

    def _found(self, name: str, plain: FloatArray) -> Compensated:
        start = time.perf_counter()
        unclamped, notes = self._solve(name, plain)
        return self._judge(name, unclamped, time.perf_counter() - start, notes, self._optimum.quality.psnr)

    @cached_property
    def _optimum(self) -> Compensated:
        start = time.perf_counter()
        best = prepare("box", self._inside, self._counts).solve(self._target)
        found = self._judge("box", best.unclamped, time.perf_counter() - start, best.notes, float("nan"))
        return replace(found, below_optimum=0.0)

    def _solve(self, name: str, plain: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        if name == "none":
            return plain.reshape(-1, 3), ()
        if name == "map" and self._maps is not None:
            return self._by_maps(self._maps).reshape(-1, 3), ()
        if self._options.max_cluster is None or name in ("direct", "triangulated"):
            found = self._prepared(name).solve(self._target)
            return found.unclamped, found.notes
        return self._solve_decomposed(name, self._options.max_cluster)

    def _by_maps(self, maps: RoomMaps) -> FloatArray:
        """Compute the drive as the player does, in the colour tier that the maps were built for."""
        ambient = maps.mixing.on_screen(self._calibration.ambient)
        return drive_of(maps, maps.mixing.unmixed(self._stated(maps.mixing) - ambient))

    def _stated(self, mixing: Mixing) -> FloatArray:
        """Return the desired picture in the screen primaries of a mixing."""
        if self._radiance:
            return np.asarray(mixing.on_screen(self._wanted), np.float64)
        return np.asarray(self._wanted * self.white, np.float64)

    def _prepared(self, name: str) -> Prepared:
        return prepare(name, self._inside, self._counts, self._objective if self._options.priors else None)

    def _solve_decomposed(self, name: str, max_cluster: int) -> tuple[FloatArray, tuple[str, ...]]:
        """Solve clusters of the near light. Far light comes from the clamped drive, and is iterated until stable."""
        shapes = self._calibration.camera.shape, self._calibration.projector.shape
        parameters, cut = decompose_to(self._inside.near, *shapes, max_cluster)
        note = f"T cut to clusters of at most {max_cluster} (radius {parameters.radius:g}, τ₁ {parameters.tau_1:g})"
        prepared, far = prepare(name, Transport(cut.near), self._counts), self._inside.far
        drives, far_notes = np.zeros(self._lit.shape), list[str]()
        for rounds in range(1, FAR_ROUNDS + 1):
            target, before = self._target.reshape(-1, 3), drives
            found = prepared.solve(target if far is None else target - far.apply(np.clip(drives, 0, 1)))
            drives, notes = found.unclamped, found.notes
            change = float(np.max(np.abs(found.drive - np.clip(before, 0, 1)), initial=0.0))
            if far is None:
                break
            far_notes = [f"far light from the clamped drive, {rounds} rounds, last change {255 * change:.2f} codes"]
            if change <= FAR_TOLERANCE:
                break
        return drives, (note, *far_notes, *notes)

    def _judge(
        self, name: str, unclamped: FloatArray, seconds: float, notes: tuple[str, ...], best: float
    ) -> Compensated:
        drive = np.clip(unclamped, 0, 1).reshape(*self._calibration.projector.shape, 3)
        arriving = reached(drive, self._calibration.response).reshape(-1, 3)
        quality = measure(self._desired, self._tier.seen(arriving), self._counts, self.white)
        beyond = np.abs(unclamped - arriving) > FAR_TOLERANCE
        clipped = float(np.mean(beyond[self._lit])) if self._lit.any() else 0.0
        return Compensated(name, drive, quality, clipped, seconds, best - quality.psnr, notes)


def compensate(
    folder: Path, picture: Path, output: Path | None, options: CompensateOptions, *, verbose: bool = False
) -> Iterator[str]:
    """Solve, write the output, and yield lines to print.

    output : .png holds the projector's code values, .exr the linear drive. With several solvers, each name is added
        before the suffix. None writes nothing.
    verbose : also yield the notes of each solver.
    """
    outputs = {} if output is None else _outputs(output, options.solvers)
    for path in outputs.values():
        check_file(path, suffixes=SUFFIXES, inputs=[picture])
    stored = calibrations.read(folder)
    calibration, radiance = stored.calibration, picture.suffix.lower() == ".exr"
    wanted = read_placed(picture, calibration.camera.shape, calibration.screen)
    tier = tier_of(calibration, read_transport(stored), options.colour)
    # read before the other solvers work, so that damage is reported early
    maps = read_maps(stored) if "map" in options.solvers else None
    task = CompensationTask(tier, wanted, radiance=radiance, options=options, maps=maps)
    given = np.asarray(tier.mixing.on_screen(wanted), np.float64) if radiance else wanted
    plain = _uncorrected(picture, given, radiance, calibration.projector.shape, task.white)
    yield f"{tier}"
    yield f"white is a camera radiance of {task.white:.4g}; {task.counted} camera pixels are lit"
    yield HEADER
    for found in task.run(plain):
        if found.solver in outputs:
            _write(outputs[found.solver], found.drive, calibration.response)
        yield str(found)
        if verbose:
            yield from (f"    {note}" for note in found.notes)
    yield from (f"{path}: written" for path in outputs.values())


def _uncorrected(path: Path, wanted: FloatArray, radiance: bool, shape: tuple[int, int], white: float) -> FloatArray:
    """Return the picture as drive: fitted to the projector, or camera radiance stretched over the projector's frame."""
    if not radiance:
        return read_placed(path, shape)
    return np.asarray(resample(wanted / white, shape, (0, 0, shape[1], shape[0])), np.float64)


def _outputs(path: Path, solvers: tuple[str, ...]) -> dict[str, Path]:
    if len(solvers) == 1:
        return {solvers[0]: path}
    return {name: path.with_name(f"{path.stem}-{name}{path.suffix}") for name in solvers}


def _write(path: Path, drive: FloatArray, response: RasterResponse) -> None:
    with replacing_file(path) as temporary:
        if path.suffix.lower() == ".exr":
            exr.write_rgb(temporary, drive.astype(np.float32))
        else:
            write_png(temporary, encoded(drive, response))
