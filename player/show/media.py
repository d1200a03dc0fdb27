"""The media of a show: found within a border, opened by processes of their own."""

from pathlib import Path

from counterlight.files.cube import Cube, read_cube
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.medium import Border, Medium
from counterlight.media.video import MediaReader
from counterlight.show.playlist import is_list, read_list


class Media:
    """How media are found and opened.  frames_per_second : of numbered pictures.  hwdec : what decodes films."""

    def __init__(self, border: Border, frames_per_second: float | None = None, hwdec: str = PROCESSOR) -> None:
        self._border, self._frames_per_second, self._hwdec = border, frames_per_second, hwdec

    def medium(self, name: str) -> Medium:
        """The medium that a key or a remote names; InputError if it may not."""
        medium = self._border.medium(name)
        medium.check()
        return medium

    def find(self, medium: Medium) -> list[Medium]:
        """The same, or the media of a list; InputError if it is plain that they cannot be played. May take long."""
        if is_list(medium):
            return read_list(medium, self._border)
        medium.look()
        return [medium]

    def cube(self, name: str) -> Cube:
        """The colour table that a key or a remote names; InputError for none, or one that it may not name."""
        return read_cube(self.medium(name).file(Path(name)))

    def begin(self, medium: Medium, *, loop: bool) -> MediaReader:
        """Begin to open a medium, without waiting."""
        rate, hwdec = self._frames_per_second, self._hwdec
        return MediaReader.begin(medium, loop=loop, frames_per_second=rate, tolerant=True, hwdec=hwdec)
