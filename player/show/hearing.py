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
        self._ahead: tuple[Medium, Track | None] | None = None

    def prepare(self, info: MediaInfo, medium: Medium) -> None:
        """Begin to decode the sound of the medium that comes next."""
        self.close()
        self._ahead = medium, self._open(info, medium)

    def close(self) -> None:
        """Leave what has been prepared."""
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead[1] is not None:
            ahead[1].close()

    def track(self, info: MediaInfo, medium: Medium) -> Track | None:
        """The sound of a medium that has one."""
        if self._ahead is not None and self._ahead[0] == medium:
            ahead, self._ahead = self._ahead, None
            return ahead[1]
        self.close()
        return self._open(info, medium)

    def _open(self, info: MediaInfo, medium: Medium) -> Track | None:
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
