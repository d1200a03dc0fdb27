"""Aiming a camera that is any other program: what to show, and the newest photograph, in FOLDER/aim."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.files.png import encode_png
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.hdr.photographs import SUFFIXES, read_photograph
from counterlight.writing.replacing import replacing_file

PATTERN = "pattern.png"
NOTHING = 480, 640  # the picture while there is none


class AimedFolder:
    """A screen that writes FOLDER/aim/pattern.png, and an eye that reads the newest picture beside it."""

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
        """Nothing here depends on a capture's number."""

    def expose(self, time: float) -> None:
        raise InputError("folder: the exposure is set at the camera")

    def skip(self) -> None:
        """Nothing waits in a folder."""

    def frame(self) -> Shot:
        """The newest photograph; the one before while that is incomplete."""
        newest = max(self._photographs(), default=None)
        if newest is not None:
            changed, path = newest
            if self._read != (path, changed):
                with suppress(InputError):  # it is still being written
                    self._shot, self._read = read_photograph(path), (path, changed)
        return self._shot

    def _photographs(self) -> list[tuple[int, Path]]:
        paths = [p for p in self._folder.iterdir() if p.suffix.lower() in SUFFIXES and p.name != PATTERN]
        return [(path.stat().st_mtime_ns, path) for path in paths if not path.name.startswith(".")]
