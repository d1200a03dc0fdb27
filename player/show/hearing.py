"""The sound of a show's media, and why none is heard, told once."""

from collections.abc import Callable

from counterlight.errors import InputError
from counterlight.media.audio import AudioOutput, Track
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium


class Hearing:
    """audio : None without an output.  silence : why there is none; None: nobody wants any.  notice : takes a line."""

    def __init__(self, audio: AudioOutput | None, silence: str | None, notice: Callable[[str], None]) -> None:
        self._audio, self._silence, self._notice = audio, silence, notice

    def track(self, info: MediaInfo, medium: Medium) -> Track | None:
        """The sound of a medium that has one."""
        if not info.sound or info.still or info.live:
            return None
        silence, self._silence = self._silence, None
        if self._audio is not None:
            try:
                return self._audio.open(medium)
            except InputError as error:
                silence = str(error)
        if silence is not None:
            self._notice(silence)
        return None
