"""Cost of cutting clusters: python -m tests.studies.decomposition prints the table of docs/decomposition.md.

The rooms are simulated: scenes of calib_data/scenes (projector 96x72, camera 160x120) and a white wall out of focus
(64x48, 80x60). Every row is T⁺ of one decomposition, clamped, seen through the whole undecomposed transport. Each row
has the λ that is best for these pictures, so that the choice of λ does not hide the cost. Pictures are a quarter of the
camera's size, enlarged, because detail that no projector pixel can show would also hide the cost.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.maps.row_map import SparseRows
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.pipeline.operators import Compensation
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.transport import Transport
from tests.rooms import blurred_transport
from tests.scenes import small

FloatArray = NDArray[np.float64]
PROJECTOR, CAMERA = (72, 96), (120, 160)
BLURRED_PROJECTOR, BLURRED_CAMERA, BLUR = (48, 64), (60, 80), 0.8
DETAIL = 4  # camera pixels per picture pixel
DAMPINGS = (0.01, 0.03, 0.1)
SIZES = (None, 1000, 200, 50)
COLUMNS = ("room", "allowed", "radius, τ₁", "kept", "clusters", "largest", "λ/σ₁", "entries of T⁺")
PICTURES = ("photograph", "letters", "ramp")


@dataclass(frozen=True)
class StudyRoom:
    """A room; `near` is its near light inside the mask.

    ambient : (camera height, camera width, 3).
    """

    name: str
    projector: tuple[int, int]
    transport: Transport
    ambient: FloatArray

    @property
    def camera(self) -> tuple[int, int]:
        return self.ambient.shape[0], self.ambient.shape[1]

    @property
    def mask(self) -> NDArray[np.bool_]:
        return directly_lit(self.transport, self.ambient, self.projector)

    @property
    def white(self) -> float:
        return reachable_white(self.transport.composition().reshape(self.ambient.shape) + self.ambient, self.mask)

    @property
    def near(self) -> SparseRows:
        return self.transport.inside(self.mask).near

    def best_inverse(self, near: SparseRows) -> tuple[Inverse, list[float]]:
        """Returns T⁺ with the λ of the highest mean quality, and its quality."""
        reach = np.maximum(self.white, self.ambient.reshape(-1, 3))
        options = [InverseOptions(damping, inverse="whole") for damping in DAMPINGS]
        inverses = [invert_near_light(near, self.mask, self.projector, reach, self.white, each) for each in options]
        return max(((inverse, self.quality(inverse)) for inverse in inverses), key=lambda pair: sum(pair[1]))

    def quality(self, inverse: Inverse) -> list[float]:
        """Returns camera PSNR in decibels of each built-in picture: compensated, clamped, seen through the whole T."""
        undo = None if self.transport.far is None else undo_far_light(self.transport.far, inverse.T_pinv)
        T_pinv = Compensation(inverse.T_pinv, undo)
        figures = []
        for coarse in typical_pictures((self.camera[0] // DETAIL, self.camera[1] // DETAIL)):
            picture = cv2.resize(coarse, self.camera[::-1], interpolation=cv2.INTER_LINEAR)
            desired = self.white * np.repeat(picture[:, :, None], 3, axis=2)
            drive = np.clip(T_pinv.apply((desired - self.ambient).reshape(-1, 3)), 0, 1)
            seen = self.transport.apply(drive).reshape(desired.shape) + self.ambient
            figures.append(camera_psnr(desired, seen, self.mask, self.white))
        return figures


def rooms() -> Iterator[StudyRoom]:
    for name in ("wall", "corner"):
        simulated = simulate(small(name, CAMERA, PROJECTOR))
        yield StudyRoom(name, PROJECTOR, simulated.transport, simulated.ambient.astype(np.float64))
    T = blurred_transport(np.random.default_rng(2006), BLURRED_CAMERA, BLURRED_PROJECTOR, BLUR)
    white = sparse.csr_array(sparse.diags_array(1 / T.sum(axis=1)) @ T, dtype=np.float32)
    out_of_focus = Transport.from_matrices((white,) * 3)
    yield StudyRoom("out of focus", BLURRED_PROJECTOR, out_of_focus, np.zeros((*BLURRED_CAMERA, 3)))


def row(room: StudyRoom, max_cluster: int | None) -> str:
    near, allowed, settings, kept = room.near, "any", "uncut", 1.0
    if max_cluster is not None:
        parameters, cut = decompose_to(near, room.camera, room.projector, max_cluster)
        near, allowed, settings = cut.near, str(max_cluster), f"{parameters.radius:g}, {parameters.tau_1:.2f}"
        kept = cut.report.connections_after / cut.report.connections_before
    inverse, figures = room.best_inverse(near)
    largest = f"{inverse.clusters.projector_sizes.max()}{' (windowed)' if inverse.windowed_clusters else ''}"
    quality = " | ".join(f"{figure:.1f}" for figure in figures)
    return (
        f"| {room.name} | {allowed} | {settings} | {100 * kept:.0f} % | {inverse.clusters.count} | {largest} "
        f"| {inverse.damping:g} | {inverse.T_pinv.indices.size} | {quality} |"
    )


def main() -> None:
    print(f"| {' | '.join(COLUMNS + PICTURES)} |")
    print("|---" * len(COLUMNS + PICTURES) + "|")
    for room in rooms():
        for max_cluster in SIZES:
            print(row(room, max_cluster), flush=True)


if __name__ == "__main__":
    main()
