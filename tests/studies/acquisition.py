"""Cost and quality of each acquisition scheme: python -m tests.studies.acquisition.

Fills docs/acquisition.csv, prints it as the table of docs/tables/schemes.md and draws docs/acquisition.png. Existing
rows are kept (`--again` measures them, and only prints). Each row is written as soon as it is known. Every room is
simulated, with a camera of 14 bits, 20 000 electrons full well and 5 electrons read noise. N shots are simulated as one
shot of N times the electrons, which equals their sum. The error of T is relative, in the Frobenius norm, against the
noise-free truth, far light included. Compensation is the box-constrained optimum of the acquired room, to 0.04 dB,
shown in the true room. The figure is the mean PSNR of a photograph and of letters. At the camera's resolution they have
detail that no projector can show. At a sixth of it, enlarged, the optimum is nearly perfect and every fault of T shows.
"""

import argparse
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from counterlight.command import parse_size
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.response import Response
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.schemes.graycode import GrayCodeScheme
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.transport import Transport, channel
from tests.studies.baselines import FixedBlocksScheme, PixelByPixelScheme

ROOT = Path(__file__).resolve().parents[2]
TABLE, PLOT = ROOT / "docs" / "acquisition.csv", ROOT / "docs" / "acquisition.png"
TRUTH = "(the truth)"
DETAILS = 1, 6  # camera pixels per picture pixel
LARGEST_DENSE = 20000  # largest projector, in pixels, for which the scheme pixel by pixel is tried
GAP = 0.01  # share of the remaining squared error: 0.04 dB
SHOTS = 16
STRIP = 2048  # camera pixels that are compared at a time
COLUMNS = (
    "room",
    "camera, projector",
    "scheme",
    "pictures",
    "exposures",
    "s",
    "error of T",
    "fine, dB",
    "smooth, dB",
    "check",
)


@dataclass(frozen=True)
class StudyRoom:
    """A simulated room that measures the quality of compensation."""

    room: SimulatedRoom

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.room.ambient.shape[0], self.room.ambient.shape[1], 3

    @property
    def mask(self) -> NDArray[np.bool_]:
        return directly_lit(self.room.transport, self.room.ambient, self.room.projector)

    def compensated(self, transport: Transport, ambient: NDArray[np.floating], detail: int) -> float:
        """Returns the mean PSNR in dB of the box optimum for a given T and e, seen in this room."""
        truth = self.room.transport
        white = reachable_white(truth.floodlight(self.room.ambient), self.mask)
        figures = []
        for small in typical_pictures((self.shape[0] // detail, self.shape[1] // detail))[:2]:
            picture = cv2.resize(small, self.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            desired = white * np.repeat(picture[:, :, None], 3, axis=2)
            target = (desired - ambient).reshape(-1, 3)
            target[~self.mask.ravel()] = 0
            drive = Box(transport.inside(self.mask), 1.0, GAP).solve(target).drive
            seen = truth.apply(drive).reshape(self.shape) + self.room.ambient
            figures.append(camera_psnr(desired, seen, self.mask, white))
        return float(np.mean(figures))


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    room: str
    size: str
    scheme: str
    pictures: int
    exposures: int
    seconds: float
    error: float
    fine: float
    smooth: float
    check: float

    def __str__(self) -> str:
        return (
            f"| {self.room} | {self.size} | {self.scheme} | {self.pictures} | {self.exposures} | {self.seconds:.1f} "
            f"| {100 * self.error:.1f} % | {self.fine:.2f} | {self.smooth:.2f} | {100 * self.check:.1f} % |"
        )


def rooms(
    camera: tuple[int, int], projector: tuple[int, int], wanted: Sequence[str] | None = None
) -> Iterator[StudyRoom]:
    """Yield the shipped scenes, a wall out of focus, and a wall with a mirrored second picture on its upper half."""
    for name, path in shipped_scenes().items():
        if wanted and name not in wanted:
            continue
        scene = load_scene(path).resized(camera, projector)
        simulated = simulate(scene)
        yield StudyRoom(
            SimulatedRoom(
                name, simulated.transport, simulated.ambient, (projector,), scene.projector.response.over(projector)
            )
        )
    if wanted and not {"out of focus", "mirror"} & set(wanted):
        return
    rng = np.random.default_rng(2006)
    ambient = np.full((*camera, 3), 0.004, np.float32)
    linear = Response("linear").over(projector)
    blurred = blurred_strips(rng, camera, projector, 1.3)
    yield StudyRoom(
        SimulatedRoom("out of focus", Transport.from_matrices((blurred,) * 3), ambient, (projector,), linear)
    )
    sharp = blurred_strips(rng, camera, projector, 0.5)
    row, column = np.mgrid[: projector[0], : projector[1]]
    mirrored = sharp[:, (row * projector[1] + projector[1] - 1 - column).ravel()]
    upper = sparse.diags_array(np.repeat(np.arange(camera[0]) < camera[0] // 2, camera[1]).astype(np.float32))
    both = sparse.csr_array(sharp + 0.5 * (upper @ mirrored), dtype=np.float32)
    yield StudyRoom(SimulatedRoom("mirror", Transport.from_matrices((both,) * 3), ambient, (projector,), linear))


def blurred_strips(
    rng: np.random.Generator, camera: tuple[int, int], projector: tuple[int, int], sigma: float
) -> sparse.csr_array:
    """Returns a textured wall through a Gaussian blur, as in tests.rooms, computed sparsely."""
    y, x = np.mgrid[: camera[0], : camera[1]]
    centre_y, centre_x = (y + 0.5) * projector[0] / camera[0] - 0.5, (x + 0.5) * projector[1] / camera[1] - 0.5
    reach = int(np.ceil(3.1 * sigma))
    offset = np.arange(-reach, reach + 1)
    v = np.rint(centre_y).astype(int).ravel()[:, None, None] + offset[:, None]
    u = np.rint(centre_x).astype(int).ravel()[:, None, None] + offset
    distance = (v - centre_y.reshape(-1, 1, 1)) ** 2 + (u - centre_x.reshape(-1, 1, 1)) ** 2
    weight = np.exp(-distance / (2 * sigma**2))
    inside = (weight >= 1e-2) & (v >= 0) & (v < projector[0]) & (u >= 0) & (u < projector[1])
    weight = np.where(inside, weight, 0)
    weight *= rng.uniform(0.4, 1, (len(weight), 1, 1)) / weight.sum(axis=(1, 2), keepdims=True)
    rows, row, column = np.nonzero(inside)
    pixel = v[rows, row, 0] * projector[1] + u[rows, 0, column]
    shape = camera[0] * camera[1], projector[0] * projector[1]
    return sparse.csr_array((weight[inside], (rows, pixel)), shape=shape, dtype=np.float32)


def schemes(projector: tuple[int, int]) -> Iterator[tuple[str, int, MakeScheme]]:
    """Yield each scheme's name, shots per pattern, and factory."""
    yield "hierarchical, τ = 4 σ", 1, HierarchicalScheme(Threshold(4))
    yield f"hierarchical, τ = 4 σ, {SHOTS} shots", SHOTS, HierarchicalScheme(Threshold(4))
    yield "multiplexed", 1, MultiplexedScheme()
    yield f"multiplexed, {SHOTS} shots", SHOTS, MultiplexedScheme()
    yield "hierarchical, τ = 16 σ", 1, HierarchicalScheme(Threshold(16))
    yield "fixed blocks", 1, FixedBlocksScheme(16)
    yield "Gray code", 1, GrayCodeScheme()
    if projector[0] * projector[1] <= LARGEST_DENSE:
        yield "pixel by pixel", 1, PixelByPixelScheme()


def sensor(shots: int) -> CameraSettings:
    """Returns a camera that behaves like the mean of `shots` shots."""
    one = Sensor()
    steps = min(16, one.bits + (shots - 1).bit_length())
    return CameraSettings(Sensor(shots * one.full_well, shots**0.5 * one.read_noise, steps))


def relative_error(found: Transport, truth: Transport) -> float:
    """Returns ‖T − T₀‖ / ‖T₀‖ over all channels."""
    square = sum(_square(((1, found), (-1, truth)), channel) for channel in range(3))
    scale = sum(_square(((1, truth),), channel) for channel in range(3))
    return float(np.sqrt(max(square, 0.0) / scale))


def _square(terms: Sequence[tuple[int, Transport]], i: int) -> float:
    """Returns ‖Σ ± T‖² for T = N + V D with V = U M, without a dense T.

    The norm is ‖N‖² + 2 ⟨N Dᵀ, V⟩ + ⟨V D Dᵀ, V⟩, the last term over all pairs of terms, in strips of camera pixels.
    """
    near = sparse.csr_array(sum(sign * channel(T.near, i).astype(np.float64) for sign, T in terms))
    fars = [(sign, T.far) for sign, T in terms if T.far is not None]
    gather = [channel(far.gather, i) for _, far in fars]
    send = [sign * sparse.csr_array(far.mix.matrices[i]) for sign, far in fars]
    total = float(np.sum(near.data**2))
    for first in range(0, near.shape[0], STRIP):
        rows = slice(first, first + STRIP)
        cells = [(channel(far.scatter, i)[rows] @ M).toarray() for (_, far), M in zip(fars, send, strict=True)]
        for V, D in zip(cells, gather, strict=True):
            total += 2 * float(np.sum((near[rows] @ D.T).toarray() * V))
            total += sum(float(np.sum((V @ (D @ other.T)) * W)) for W, other in zip(cells, gather, strict=True))
    return total


def study(place: StudyRoom, size: str, known: Collection[str]) -> Iterator[Row]:
    """Yield the rows of the truth and of every scheme whose name is not in `known`."""
    room = place.room
    if TRUTH not in known:
        fine, smooth = (place.compensated(room.transport, room.ambient, detail) for detail in DETAILS)
        yield Row(room.name, size, TRUTH, 0, 0, 0.0, 0.0, fine, smooth, 0.0)
    for name, shots, make_scheme in schemes(room.projector):
        if name in known:
            continue
        eye = SimulatedCamera(room, sensor(shots))
        start = time.perf_counter()
        done: Acquisition = acquire(eye, MemoryStore(eye.exposures), make_scheme, room.projectors)[0]
        seconds = time.perf_counter() - start
        transport = done.measured.transport
        fine, smooth = (place.compensated(transport, done.room.black, detail) for detail in DETAILS)
        error, estimated = relative_error(transport, room.transport), done.check.error
        yield Row(room.name, size, name, done.pictures, shots * done.pictures, seconds, error, fine, smooth, estimated)


def read_rows() -> list[Row]:
    if not TABLE.exists():
        return []
    kinds = [field.type for field in fields(Row)]
    lines = TABLE.read_text().splitlines()[1:]
    return [Row(*(kind(word) for kind, word in zip(kinds, line.split(";"), strict=True))) for line in lines]  # type: ignore[operator,misc]


def write_rows(rows: Sequence[Row]) -> None:
    head = ";".join(field.name for field in fields(Row))
    lines = [
        ";".join(f"{value:.5g}" if isinstance(value, float) else str(value) for value in astuple(row)) for row in rows
    ]
    TABLE.write_text("\n".join([head, *lines]) + "\n")


def draw(rows: Sequence[Row]) -> None:
    """Draw exposures against the error of T, both logarithmic, one panel per room, at the smallest size of each."""
    from matplotlib import pyplot
    from matplotlib.lines import Line2D

    names = list(dict.fromkeys(row.room for row in rows))
    kinds = [kind for kind in dict.fromkeys(row.scheme for row in rows) if kind != TRUTH]
    figure, panels = pyplot.subplots(-(-len(names) // 3), 3, figsize=(11, 8), sharex=True, sharey=True, squeeze=False)
    for panel in panels.ravel()[len(names) :]:
        panel.axis("off")
    for name, panel in zip(names, panels.ravel(), strict=False):
        here = [row for row in rows if row.room == name]
        here = [row for row in here if row.size == here[0].size]
        for i, kind in enumerate(kinds):
            found = [row for row in here if row.scheme == kind]
            panel.loglog([row.exposures for row in found], [100 * row.error for row in found], "o", color=f"C{i}", ms=8)
        panel.set_title(name, fontsize=10)
        panel.grid(alpha=0.3)
    figure.supxlabel("exposures")
    figure.supylabel("error of T, %")
    marks = [Line2D([], [], marker="o", ls="", color=f"C{i}", label=kind) for i, kind in enumerate(kinds)]
    figure.legend(handles=marks, loc="lower center", ncols=3, bbox_to_anchor=(0.5, 0.03))
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    figure.savefig(PLOT, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.acquisition", description=__doc__)
    parser.add_argument("--camera", type=parse_size, default=(72, 96), help="camera size (default 96x72)")
    parser.add_argument("--projector", type=parse_size, default=(96, 128), help="projector size (default 128x96)")
    parser.add_argument("--room", action="append", help="measure only this room; may be repeated")
    parser.add_argument("--again", action="store_true", help="measure every row, print the table, and change no file")
    parser.add_argument("--draw-only", action="store_true", help="measure nothing; print and draw the existing rows")
    options = parser.parse_args()
    if options.again:
        print(as_table(in_order(measured(options, again=True))))
        return
    if not options.draw_only:
        for row in measured(options, again=False):
            write_rows([*read_rows(), row])
    rows = in_order(read_rows())
    print(as_table(rows))
    draw(rows)


def measured(options: argparse.Namespace, *, again: bool) -> Iterator[Row]:
    """Yield each row as soon as it is known.

    again : also measure the rows that the table has.
    """
    size = "{1}x{0}, {3}x{2}".format(*options.camera, *options.projector)
    with threadpool_limits(limits=1):
        for place in rooms(options.camera, options.projector, options.room):
            at = place.room.name, size
            for row in study(
                place, size, set() if again else {r.scheme for r in read_rows() if (r.room, r.size) == at}
            ):
                print(row, file=sys.stderr, flush=True)
                yield row


def in_order(rows: Iterable[Row]) -> list[Row]:
    """Sort by size (the smallest first), room and scheme."""
    return sorted(rows, key=lambda row: (len(row.size), row.size, row.room, row.scheme))


def as_table(rows: Sequence[Row]) -> str:
    """Returns the table of docs/tables/schemes.md."""
    return "\n".join([f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|", *map(str, rows)])


if __name__ == "__main__":
    main()
