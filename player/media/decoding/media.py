"""Chooses the source for a medium's name: OpenEXR pictures are read here, all others by FFmpeg."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.decoding.ffmpeg_source import FfmpegSource
from counterlight.media.decoding.live_source import LiveSource
from counterlight.media.decoding.pixels import MAX_PIXELS, UNTAGGED, Samples, Tags, check_finite, describe
from counterlight.media.decoding.source import Decoded, Sequence, Source, is_wanted
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium
from counterlight.writing.numbered import number_of
from counterlight.writing.stage import finish

SEQUENCE_RATE = 25.0


def open_source(
    medium: Medium, frames_per_second: float | None, *, tolerant: bool = False, hwdec: str = PROCESSOR
) -> Source:
    """Open a file, a pattern such as `frames/%05d.png` or a live source, and decode its first picture.

    tolerant : skip pictures that FFmpeg cannot decode. OpenEXR pictures must be complete.
    hwdec : device that decodes films, see devices.py.
    """
    medium.check()
    live = medium.live()
    if live is not None:
        return LiveSource(medium, live)
    path = Path(medium.name)
    if medium.is_sequence:
        medium.inside(path.parent)
        start, paths = _sequence(path)
        rate, files = frames_per_second or SEQUENCE_RATE, [medium.file(each) for each in paths]
        if path.suffix.lower() == ".exr":
            return ExrSource(path, files, rate)
        return FfmpegSource(medium, Sequence(start, len(paths), rate), tolerant=tolerant)
    if path.suffix.lower() == ".exr":
        return ExrSource(path, [medium.file(path)], SEQUENCE_RATE)
    return FfmpegSource(medium, None, tolerant=tolerant, hwdec=hwdec)


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


def _sequence(pattern: Path) -> tuple[int, list[Path]]:
    """Return the first number and the files of a pattern. Raises InputError if there is no file or a number is missing.

    Files that a killed command had staged are moved into place first.
    """
    finish(pattern)
    try:
        entries = os.listdir(pattern.parent)
    except OSError as error:
        raise InputError(f"{pattern.parent}: {error.strerror}; check the sequence's folder and its rights") from None
    found = {number_of(pattern.name, entry): pattern.parent / entry for entry in entries}
    numbered = {number: path for number, path in found.items() if number is not None}
    if not numbered:
        raise InputError(f"{pattern}: no file matches this pattern; check its name and its number of digits")
    first, last = min(numbered), max(numbered)
    missing = next((n for n in range(first, last + 1) if n not in numbered), None)
    if missing is not None:
        raise InputError(
            f"{pattern}: number {missing} is missing between {first} and {last}; add it or renumber the files"
        )
    return first, [numbered[n] for n in range(first, last + 1)]


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
