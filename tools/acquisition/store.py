"""Captures on disk, each whole or absent, so that an acquisition can be killed at any moment and go on.

FOLDER/session.toml            what these captures are of; a run with other options is refused
FOLDER/captures/00012.png      capture 12 (00012_0.png, 00012_1.png … for a bracket), codes as the camera gave them
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from player.errors import InputError, shown
from player.files import flush, refusals_named, replacing_file, write_toml
from player.picture_files import read_picture
from player.reading import read_toml
from tools.acquisition.cameras.camera import Exposures, Shot

SESSION = "session.toml"
FORMAT = 2  # 1: black and floodlight four times each


class CaptureStore:
    """The captures of one acquisition; InputError if `folder` holds those of another."""

    def __init__(self, folder: Path, session: dict[str, Any], exposures: Exposures) -> None:
        self._folder, self._captures, self._exposures = folder, folder / "captures", exposures
        self._size: tuple[int, ...] | None = None
        session = {"format": FORMAT, "exposures": list(exposures.times), **session}
        if (folder / SESSION).exists():
            _refuse_other(folder, session)
        elif folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder}: exists and holds no captures of an acquisition; name another with --captures")
        with refusals_named(folder):
            self._captures.mkdir(parents=True, exist_ok=True)
            for left in self._captures.glob(".*.partial.png"):  # of a run that was killed
                left.unlink()
        if not (folder / SESSION).exists():
            with replacing_file(folder / SESSION) as temporary:
                write_toml(temporary, session)

    def has(self, number: int) -> bool:
        return all(path.is_file() for path in self._paths(number))

    def save(self, number: int, shots: Sequence[Shot]) -> None:
        """Put a capture on disk; it is there for good when this returns.

        Raises InputError where the disk refuses, for another count of shots than exposures, and for another size.
        """
        paths = self._paths(number)
        if len(shots) != len(paths):
            raise InputError(f"capture {number}: {len(shots)} shots, expected {len(paths)}, one for each exposure")
        for path, shot in zip(paths, shots, strict=True):
            self._check_size(path, shot)
            _, content = cv2.imencode(".png", shot if shot.ndim == 2 else shot[..., ::-1])
            with replacing_file(path) as temporary:
                temporary.write_bytes(content.tobytes())
        with refusals_named(self._captures):
            flush(self._captures)

    def shots(self, number: int) -> tuple[Shot, ...]:
        shots = tuple(read_picture(path) for path in self._paths(number))
        for path, shot in zip(self._paths(number), shots, strict=True):
            self._check_size(path, shot)
        return shots

    def radiance(self, number: int) -> NDArray[np.float32]:
        """(camera height, camera width, 3)."""
        return self._exposures.radiance(self.shots(number))

    def _paths(self, number: int) -> list[Path]:
        count = len(self._exposures.times)
        names = [f"{number:05}"] if count == 1 else [f"{number:05}_{shot}" for shot in range(count)]
        return [self._captures / f"{name}.png" for name in names]

    def _check_size(self, path: Path, shot: Shot) -> None:
        self._size = self._size or shot.shape[:2]
        if shot.shape[:2] != self._size:
            height, width = self._size
            raise InputError(
                f"{path}: {shot.shape[1]}x{shot.shape[0]}, the captures before are {width}x{height}; a camera must "
                "not change its size or orientation in between"
            )


def _refuse_other(folder: Path, session: dict[str, Any]) -> None:
    fix = "name another folder with --captures, or remove this one"
    stored = read_toml(folder / SESSION, fix)
    for key in sorted({*stored, *session}):
        if stored.get(key) != session.get(key):
            raise InputError(
                f"{folder}: captures of another acquisition ({key}: {shown(stored.get(key))} there, "
                f"{shown(session.get(key))} here); {fix}"
            )
