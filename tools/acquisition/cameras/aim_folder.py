"""Aim a camera that another program controls: FOLDER/aim holds the picture to show and the newest photograph."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.files.picture_files import encode_png
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.hdr.photographs import SUFFIXES, read_photograph
from counterlight.writing.replacing import replacing_file

PATTERN = "pattern.png"
NOTHING = 480, 640  # size of the placeholder until there is a photograph


class AimedFolder:
    """A screen that writes FOLDER/aim/pattern.png, and an eye that reads the newest photograph in FOLDER/aim."""

    timed, refresh_hz = False, None

    def __init__(self, folder: Path, shape: tuple[int, int]) -> None:
        self._folder, self.shape = folder / "aim", shape
        self._read: tuple[Path, int] | None = None
        self._shot: Shot = np.zeros(NOTHING, np.uint8)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self._folder}: cannot be made ({error.strerror}); check path and rights") from None

    @property
    def name(self) -> str:
        return f"{self._read[0].name}" if self._read else f"waiting for a photograph in {self._folder}"

    def show(self, codes: Codes) -> None:
        with replacing_file(self._folder / PATTERN) as temporary:
            temporary.write_bytes(encode_png(codes))

    def begin(self, number: int) -> None:
        """Does nothing: frames do not depend on a capture's number."""

    def expose(self, time: float) -> None:
        raise InputError("folder: the exposure is set at the camera")

    def skip(self) -> None:
        """Does nothing: a folder has no frames to skip."""

    def frame(self) -> Shot:
        """Returns the newest photograph, or the previous photograph while the newest is incomplete."""
        newest = max(self._photographs(), default=None)
        if newest is not None:
            changed, path = newest
            if self._read != (path, changed):
                with suppress(InputError):  # the newest photograph may still be incomplete
                    self._shot, self._read = read_photograph(path), (path, changed)
        return self._shot

    def _photographs(self) -> list[tuple[int, Path]]:
        paths = [p for p in self._folder.iterdir() if p.suffix.lower() in SUFFIXES and p.name != PATTERN]
        return [(path.stat().st_mtime_ns, path) for path in paths if not path.name.startswith(".")]
