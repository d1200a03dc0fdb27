"""An exposure bracket on disk: pictures, read one at a time, and their exposure times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.hdr.photographs import read_photograph
from counterlight.tools.hdr.raw_files import exposure_times

CANDIDATES = 1 << 15  # pixels considered for a recovery, on a regular grid
REACH = 2  # a pixel is compared with its neighbours up to this distance
ALIKE = 1 / 8  # share of the range; an edge that moves between pictures would falsify the response
LEAST_SAMPLES = 500


@dataclass(frozen=True)
class Bracket:
    """Pictures of one scene and their exposure times.

    times_s : (pictures,). Seconds.
    """

    paths: tuple[Path, ...]
    times_s: FloatArray

    def shots(self) -> Iterator[tuple[NDArray[Any], float]]:
        """Yield the code values (height, width, 1 or 3), uint8 or uint16, and the exposure time of each picture.

        Raises InputError for unreadable pictures, for pictures that differ in size or kind, and, at the end, if longer
        exposures are not brighter.
        """
        first, means = "", []
        for path, exposure_s in zip(self.paths, self.times_s, strict=True):
            picture = read_photograph(path)
            kind = _kind(picture)
            first = first or kind
            if kind != first:
                raise InputError(
                    f"{path}: {kind}, expected {first} as in {self.paths[0].name}; all pictures come from one camera "
                    "with one setting"
                )
            means.append(float(picture.mean()) / float(np.iinfo(picture.dtype).max))
            yield picture if picture.ndim == 3 else picture[..., None], float(exposure_s)
        self._check_brightness(np.array(means))

    def samples(self) -> FloatArray:
        """Returns codes of the same pixels, away from edges, in all pictures: (pictures, pixels, channels), 0 to 1."""
        codes, spread = [], np.zeros(0)
        for picture, _ in self.shots():
            patches = _patches(picture) / float(np.iinfo(picture.dtype).max)
            codes.append(patches[len(patches) // 2])
            unlike = np.ptp(patches, axis=0).max(axis=-1)
            spread = np.maximum(spread, unlike) if spread.size else unlike
        flattest = np.argsort(spread, kind="stable")
        return np.stack(codes)[:, flattest[: max(LEAST_SAMPLES, int((spread <= ALIKE).sum()))]]

    def _check_brightness(self, means: FloatArray) -> None:
        order = np.argsort(self.times_s, kind="stable")
        for shorter, longer in pairwise(order):
            if means[longer] < means[shorter] - 0.5 / 255 and self.times_s[longer] > self.times_s[shorter]:
                raise InputError(
                    f"{self.paths[longer]}: {self.times_s[longer]:g} s, darker than {self.paths[shorter].name} with "
                    f"{self.times_s[shorter]:g} s; give the times in the order of the pictures"
                )
        if np.ptp(self.times_s) > 0 and np.ptp(means) < 0.5 / 255 and 0.02 < means.mean() < 0.98:
            raise InputError(
                f"{self.paths[0]} and the others: equally bright with {self.times_s.min():g} to "
                f"{self.times_s.max():g} s; the camera did not follow, set it to manual exposure"
            )


def open_bracket(paths: Sequence[Path], times_s: Sequence[float] | None, *, repeated: bool = False) -> Bracket:
    """Pair pictures with their exposure times.

    times_s : seconds, one per picture; None reads EXIF.
    repeated : whether the pictures are shots of one exposure instead of a bracket.

    Raises InputError for a single picture, and for times that are missing, too many, not positive, or all the same (for
    repeated shots: not all the same).
    """
    if len(paths) < 2:
        raise InputError(f"{paths[0]}: one picture, expected at least two; name all pictures of the bracket")
    if times_s is not None and len(times_s) != len(paths):
        raise InputError(f"--times: {len(times_s)} times for {len(paths)} pictures; give one for each, in their order")
    times = exposure_times(paths) if times_s is None else np.array(times_s, np.float64)
    if not (np.isfinite(times).all() and np.all(times > 0)):
        raise InputError(f"--times: {times.min():g} s, expected positive times")
    if not repeated and np.ptp(times) == 0:
        raise InputError(
            f"{paths[0]} and the others: all {times[0]:g} s, expected a bracket of different times; repeated shots of "
            "one exposure are merged with --method average"
        )
    if repeated and np.ptp(times) > 0:
        raise InputError(
            f"--method average: {times.min():g} to {times.max():g} s, expected shots of one exposure; merge a bracket "
            "with --method debevec or robertson"
        )
    return Bracket(tuple(paths), times)


def _patches(picture: NDArray[Any]) -> NDArray[Any]:
    """Returns the neighbourhood of each candidate pixel, (offsets, pixels, channels), with the pixel in the middle."""
    height, width = picture.shape[:2]
    step = max(1, int(np.ceil(np.sqrt(height * width / CANDIDATES))))
    y, x = (axis.ravel() for axis in np.mgrid[step // 2 : height : step, step // 2 : width : step])
    offsets = range(-REACH, REACH + 1)
    rows = [np.clip(y + dy, 0, height - 1) for dy in offsets]
    columns = [np.clip(x + dx, 0, width - 1) for dx in offsets]
    return np.stack([picture[row, column] for row in rows for column in columns])


def _kind(picture: NDArray[Any]) -> str:
    colour = "colour" if picture.ndim == 3 else "grey"
    return f"{picture.shape[1]}x{picture.shape[0]} {colour} {8 * picture.dtype.itemsize}-bit"
