"""Opens the sound of a show's media. If there is no sound, one notice gives the reason."""

from collections.abc import Callable
from contextlib import suppress

from counterlight.errors import InputError
from counterlight.media.audio import AudioOutput, Track
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium


class Hearing:
    """Opens the sound of each medium.

    audio : None without an output.
    silence : reason why there is no output; None if the user wants no sound.
    notice : takes a line for the user.
    """

    def __init__(self, audio: AudioOutput | None, silence: str | None, notice: Callable[[str], None]) -> None:
        self._audio, self._silence, self._notice = audio, silence, notice
        self._prepared: tuple[Medium, Track] | None = None

    def prepare(self, info: MediaInfo, medium: Medium) -> None:
        """Begin to decode the sound of the next medium."""
        self.close()
        if self._audio is not None and _has_sound(info):
            with suppress(InputError):  # `track` reports the error
                self._prepared = medium, self._audio.open(medium)

    def track(self, info: MediaInfo, medium: Medium) -> Track | None:
        """Return the sound of a medium, None if it has no sound. The sound replaces the previous medium's sound."""
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
        """Return the prepared track if it belongs to this medium, otherwise None."""
        if self._prepared is None or self._prepared[0] != medium:
            return None
        (_, track), self._prepared = self._prepared, None
        return track

    def close(self) -> None:
        """Close the prepared track."""
        if self._prepared is not None:
            self._prepared[1].close()
        self._prepared = None


def _has_sound(info: MediaInfo) -> bool:
    return info.sound and not info.still and not info.live
