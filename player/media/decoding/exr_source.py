"""Source of OpenEXR pictures, loaded only for them: its libraries take a twentieth of a decoder's start."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.media.decoding.pixels import MAX_PIXELS, UNTAGGED, Samples, Tags, check_finite, describe
from counterlight.media.decoding.source import Decoded, is_wanted
from counterlight.media.frames import MediaInfo


class ExrSource:
    """One OpenEXR picture or a numbered sequence, as linear radiance."""

    def __init__(self, path: Path, paths: list[Path], rate: float) -> None:
        self.notices: list[str] = []
        self.flip_rows = False
        self._paths, self._rate = paths, rate
        self.end_s = len(paths) / rate
        self._first: Samples | None = _read_exr(paths[0])
        tags = Tags(UNTAGGED, UNTAGGED, picture=True, centered=False)
        pixels = describe(self._first, tags, rotation=0, pixel_aspect=1.0)
        still = len(paths) == 1
        self.info = MediaInfo(path, pixels, rate, None if still else self.end_s, still, "exr", len(paths))

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded | str]:
        """See Source."""
        for i, path in enumerate(self._paths):
            start_s, end_s = i / self._rate, (i + 1) / self._rate
            if is_wanted(start_s, end_s, from_s, after=after):
                samples, self._first = (self._first if i == 0 else None) or _read_exr(path), None
                self._check_same(path, samples)
                yield Decoded(start_s, 1 / self._rate, samples)

    def _check_same(self, path: Path, samples: Samples) -> None:
        height, width = samples.planes[0].shape
        expected = self.info.format
        if (width, height) != (expected.width, expected.height):
            size = f"{width}x{height}, expected {expected.width}x{expected.height}"
            raise InputError(f"{path}: {size} like the first of its sequence; export the sequence at one size")


def _check_shown(header: exr.Header, name: str) -> None:
    if header.width * header.height > MAX_PIXELS:
        raise InputError(
            f"{name}: claims {header.width}x{header.height} pixels, at most {MAX_PIXELS} are shown; scale it down"
        )


def _read_exr(path: Path) -> Samples:
    linear_rgb = exr.read_rgb(path, _check_shown)
    r, g, b = (np.ascontiguousarray(linear_rgb[..., i]) for i in range(3))
    try:
        check_finite((r, g, b))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return Samples("radiance", 32, (r, g, b))
