"""The sound of a show's media, and why none is heard, told once."""

from collections.abc import Callable
from contextlib import suppress

from counterlight.errors import InputError
from counterlight.media.audio import AudioOutput, Track
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium


class Hearing:
    """audio : None without an output.  silence : why there is none; None: nobody wants any.  notice : takes a line."""

    def __init__(self, audio: AudioOutput | None, silence: str | None, notice: Callable[[str], None]) -> None:
        self._audio, self._silence, self._notice = audio, silence, notice
        self._prepared: tuple[Medium, Track] | None = None

    def prepare(self, info: MediaInfo, medium: Medium) -> None:
        """Begin to decode the sound of the medium that comes next."""
        self.close()
        if self._audio is not None and _has_sound(info):
            with suppress(InputError):  # which `track` tells
                self._prepared = medium, self._audio.open(medium)

    def track(self, info: MediaInfo, medium: Medium) -> Track | None:
        """The sound of a medium that has one, heard from now on in place of the one before."""
        if not _has_sound(info):
            return None
        silence, self._silence = self._silence, None
        if self._audio is not None:
            try:
                track = self._take(medium) or self._audio.open(medium)
                self._audio.hear(track)
                return track
            except InputError as error:
                silence = str(error)
        if silence is not None:
            self._notice(silence)
        return None

    def _take(self, medium: Medium) -> Track | None:
        """What has been prepared, if it is this medium's."""
        if self._prepared is None or self._prepared[0] != medium:
            return None
        (_, track), self._prepared = self._prepared, None
        return track

    def close(self) -> None:
        """Leave what has been prepared."""
        if self._prepared is not None:
            self._prepared[1].close()
        self._prepared = None


def _has_sound(info: MediaInfo) -> bool:
    return info.sound and not info.still and not info.live
