"""Finds the media that users and remotes may name, and opens them in separate processes."""

from functools import partial
from pathlib import Path

from counterlight.errors import InputError
from counterlight.files.cube import Cube, read_cube
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.medium import Border, Medium
from counterlight.media.video import MediaReader
from counterlight.show.lookup import LookUp
from counterlight.show.playlist import entries_of, listed

BROWSE_S = 0.1  # longest time that a show waits for a folder
MOST_LISTED = 2000  # most paths that are listed per folder


def _listed(medium: Medium) -> dict[str, list[str]]:
    entries = entries_of(medium)[:MOST_LISTED]
    return {
        "folders": [str(each) for each in entries if each.is_dir()],
        "files": [str(each) for each in entries if each.is_file()],
    }


class Media:
    """Finds and opens media.

    border : the files that may be named.
    frames_per_second : rate of numbered pictures.
    hwdec : the device that decodes films.
    """

    def __init__(self, border: Border, frames_per_second: float | None = None, hwdec: str = PROCESSOR) -> None:
        self._border, self._frames_per_second, self._hwdec = border, frames_per_second, hwdec

    def medium(self, name: str) -> Medium:
        """Return the medium that a key or a remote names. Raises InputError if it is out of bounds."""
        medium = self._border.medium(name)
        medium.check()
        return medium

    def find(self, medium: Medium) -> list[Medium]:
        """Return the medium itself, or the media of a list or a folder. May take long.

        Raises InputError if they obviously cannot be played.
        """
        found = listed(medium, self._border)
        if found == [medium]:
            medium.look()
        return found

    def browse(self, folder: str) -> dict[str, list[str]]:
        """Return the paths of the folders and files in a folder, or the border's folders if `folder` is empty.

        Names that begin with a dot are omitted. Raises InputError for a folder outside the border and for a slow disk.
        """
        if not folder:
            return {"folders": list(self._border.roots), "files": []}
        found = LookUp(partial(_listed, self._border.medium(folder))).result(BROWSE_S)
        if found is None:
            raise InputError(f"{folder}: not listed within {BROWSE_S:g} s; copy it to a local disk")
        return found

    def cube(self, name: str) -> Cube:
        """Return the named colour table. Raises InputError if it cannot be read or is out of bounds."""
        return read_cube(self.medium(name).file(Path(name)))

    def begin(self, medium: Medium, *, loop: bool) -> MediaReader:
        """Begin to open a medium, without waiting."""
        rate, hwdec = self._frames_per_second, self._hwdec
        return MediaReader.begin(medium, loop=loop, frames_per_second=rate, tolerant=True, hwdec=hwdec)
