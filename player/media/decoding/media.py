"""Chooses the source for a medium's name: FFmpeg reads everything but OpenEXR pictures."""

import os
from pathlib import Path

from counterlight.errors import InputError
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.decoding.ffmpeg_source import FfmpegSource
from counterlight.media.decoding.live_source import LiveSource
from counterlight.media.decoding.source import Sequence, Source
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
    if not medium.is_sequence:
        if path.suffix.lower() == ".exr":
            return _exr(path, [medium.file(path)], SEQUENCE_RATE)
        return FfmpegSource(medium, None, tolerant=tolerant, hwdec=hwdec)
    medium.inside(path.parent)
    start, paths = _sequence(path)
    rate, files = frames_per_second or SEQUENCE_RATE, [medium.file(each) for each in paths]
    if path.suffix.lower() == ".exr":
        return _exr(path, files, rate)
    return FfmpegSource(medium, Sequence(start, len(paths), rate), tolerant=tolerant)


def _exr(path: Path, files: list[Path], rate: float) -> Source:
    from counterlight.media.decoding.exr_source import ExrSource

    return ExrSource(path, files, rate)


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
