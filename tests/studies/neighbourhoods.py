"""The thesis' cut of near and far light in one T: python -m tests.studies.neighbourhoods.

Prints docs/tables/radii.md and draws docs/neighbourhoods.png, the counterpart of figure 4.8. The room is
the shipped `folded_cards`, small; a sixth of its light is far light. T is dense, also without the entries that an
acquisition with a threshold of a thousandth of the brightest entry would miss. Each row is cut with a radius and τ₁,
its energy is fitted (4.2.3), and each cluster is inverted by numpy's SVD, without small singular values. The clamped
drive is judged through the whole T: decibels of camera PSNR below the best that a projector can show.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.files.picture_files import write_png
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.clusters.decomposition import Parameters, decompose
from counterlight.tools.report.pictures import cluster_picture
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.study.rooms import StudyRoom, Task, open_room
from counterlight.tools.transport.transport import channels, in_one, luminance, luminance_matrix

SIZE = (36, 48)  # camera (height, width)
FOUND = 1e-3  # share of the brightest entry; an acquisition misses fainter entries
DRAWN_RADII = (3, 5, 10, 15)  # radii of figure 4.8
WHOLE = 100  # radius that covers the whole picture
CUTS = {  # share of the brightest entry -> radius and τ₁, (0, 0) for no cut
    0.0: ((0, 0.0), (3, 1.0), (WHOLE, 0.1), (WHOLE, 0.3), (WHOLE, 1.0)),
    FOUND: ((0, 0.0), *((radius, 1.0) for radius in DRAWN_RADII), (WHOLE, 0.1), (WHOLE, 1.0)),
}
LEFT_OUT = (1e-6, 0.01, 0.03)  # singular values up to this share of a cluster's largest are dropped
PICTURES = ("photograph", "text", "gradient")
COLUMNS = ("entries from", "radius, τ₁", "light kept", "clusters", "largest", *(f"σ above {s:g} σ₁" for s in LEFT_OUT))
PLOT, ENLARGED, MARGIN = Path(__file__).resolve().parents[2] / "docs" / "neighbourhoods.png", 5, 6


def thresholded(T: SparseRows, share: float) -> SparseRows:
    """Drop entries below a share of the brightest entry."""
    light = luminance(T.weights)
    return T.where(light > share * light.max())


def cut(room: StudyRoom, T: SparseRows, radius: float, tau_1: float) -> tuple[SparseRows, float]:
    """Returns the cut T with fitted energy, and the share of the light in the connections that are kept."""
    if not radius:
        return T, 1.0
    shapes = room.calibration.camera.shape, room.calibration.projector.shape
    near = decompose(T, *shapes, Parameters(radius, tau_1)).near
    kept = luminance_matrix(T) * (luminance_matrix(near) > 0)
    return near, float(kept.sum() / luminance(T.weights).sum())


def inverses(near: SparseRows) -> list[list[FloatArray]]:
    """Returns T⁺ of each channel for each share of LEFT_OUT, cluster by cluster."""
    clusters = find_clusters(luminance_matrix(near))
    found = []
    for T in channels(near):
        T_pinv = [np.zeros(T.shape[::-1]) for _ in LEFT_OUT]
        for label in range(clusters.count):
            seen, lit = np.flatnonzero(clusters.camera == label), np.flatnonzero(clusters.projector == label)
            U, sigma, Vt = np.linalg.svd(T[seen][:, lit].toarray().astype(np.float64), full_matrices=False)
            for inverse, share in zip(T_pinv, LEFT_OUT, strict=True):
                used = sigma > share * sigma[0]
                inverse[np.ix_(lit, seen)] = (Vt[used].T / sigma[used]) @ U[:, used].T
        found.append(T_pinv)
    return [[of_channel[i] for of_channel in found] for i in range(len(LEFT_OUT))]


def below(tasks: list[Task], T_pinv: list[FloatArray]) -> str:
    """Returns dB below the best for each picture."""
    drives = (np.stack([P @ task.asked[:, i] for i, P in enumerate(T_pinv)], axis=1) for task in tasks)
    judged = (task.judge(np.clip(drive, 0, 1)) for task, drive in zip(tasks, drives, strict=True))
    return ", ".join(f"{each.below_optimum:.1f}" for each in judged)


def rows(room: StudyRoom) -> Iterator[str]:
    tasks, whole = [Task(room, picture) for picture in find_pictures(PICTURES)], in_one(room.inside)
    for share, settings in CUTS.items():
        T = thresholded(whole, share)
        for radius, tau_1 in settings:
            near, kept = cut(room, T, radius, tau_1)
            clusters = find_clusters(luminance_matrix(near))
            words = "uncut" if not radius else f"{'all' if radius == WHOLE else f'{radius:g}'}, {tau_1:g}"
            figures = " | ".join(below(tasks, T_pinv) for T_pinv in inverses(near))
            size = clusters.projector_sizes.max()
            yield f"| {share:g} | {words} | {100 * kept:.0f} % | {clusters.count} | {size} | {figures} |"


def draw(room: StudyRoom) -> None:
    """Draw clusters in the camera picture by radius, and in the projector picture below."""
    T, columns = thresholded(in_one(room.inside), FOUND), []
    for radius in DRAWN_RADII:
        clusters = find_clusters(luminance_matrix(cut(room, T, radius, 1.0)[0]))
        pictures = [
            cluster_picture(clusters.camera, room.calibration.camera.shape),
            cluster_picture(clusters.projector, room.calibration.projector.shape),
        ]
        columns.append([_enlarged(picture) for picture in pictures])
    lines = [np.hstack([column[i] for column in columns]) for i in range(2)]
    width = max(line.shape[1] for line in lines)
    write_png(PLOT, np.vstack([np.pad(line, ((0, 0), (0, width - line.shape[1]), (0, 0))) for line in lines]))


def _enlarged(
    picture: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    large = np.kron(picture, np.ones((ENLARGED, ENLARGED, 1), np.uint8))
    return np.pad(large, ((0, MARGIN), (0, MARGIN), (0, 0)))


def main() -> None:
    room = open_room(shipped_scenes()["folded_cards"], SIZE)
    draw(room)
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
    for row in rows(room):
        print(row, flush=True)


if __name__ == "__main__":
    main()
