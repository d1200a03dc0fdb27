"""Values with which a session begins, grouped by subject."""

from dataclasses import dataclass

from counterlight.media.audio import AudioOutput
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments


@dataclass(frozen=True)
class Playing:
    """How media are played when the session begins.

    start_s : where the first medium starts.
    image_display_duration : seconds that a still is shown; None for no limit.
    keep_open : what stays at the end of the list, an option of options.py.
    fade_s, crossfade_s : seconds of a fade from and to black, and between two media.
    """

    loop_file: bool = False
    speed: float = 1.0
    start_s: float = 0.0
    image_display_duration: float | None = None
    keep_open: str = "auto"
    fade_s: float = 0.0
    crossfade_s: float = 0.0


@dataclass(frozen=True)
class Showing:
    """What the screen shows when the session begins.

    view, compensation, blackout, osd : the options of these names.
    adjustments : the viewer's settings.
    """

    view: str = "projector"
    compensation: bool = True
    adjustments: Adjustments = NEUTRAL
    blackout: bool = False
    osd: str = "auto"


@dataclass(frozen=True)
class Sound:
    """The output of sound.

    output : None if there is no output.
    silence : why there is no output, reported when a medium has sound; None if the user wants no sound.
    """

    output: AudioOutput | None = None
    silence: str | None = None


PLAYING, SHOWING, NO_SOUND = Playing(), Showing(), Sound()
