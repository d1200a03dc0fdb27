"""The table of all parameters of a show: name, allowed values, default and help text.

Each row is an option of counterlight play, a setting, a property of the control socket, and a line of docs/player.md.
"""

from dataclasses import dataclass
from typing import Any

from counterlight.pipeline.refinement import MOST_STEPS
from counterlight.pipeline.test_cards import CARDS
from counterlight.pipeline.value_types import Choice, Flag, Kind, Number, Places
from counterlight.pipeline.views import VIEWS
from counterlight.viewpoints import FARTHEST, MOST_VIEWS


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    help : help text.
    kind : the values that it takes.
    default : None if it depends on the media or the room; `unsaid` then describes it.
    value : placeholder in --help.
    unit : unit shown after the value on the screen.
    unsaid : the default in words.
    """

    help: str
    kind: Kind
    default: Any = None
    value: str = "N"
    unit: str = ""
    unsaid: str = ""


LISTED_IMAGE_S = 5.0  # seconds that a picture in a list is shown by default
LUT_TYPES = ("native", "conversion")
TONE_MAPPINGS = ("bt.2390", "clip")
OSD = ("auto", "off", "on", "notices")
KEEP_OPEN = ("auto", "no", "yes", "always", "black")
FLAG, CONTROL = Flag(), Number(-100, 100, whole=True)
STEPS = Number(0, MOST_STEPS, whole=True, words=("auto",), noun="a number of steps")
PARAMETERS = {
    "speed": Parameter("media seconds a second", Number(0.01, 100), 1.0, "FACTOR"),
    "image-display-duration": Parameter(
        "how long a picture is shown",
        Number(0.01, 1e6, words=("inf",), noun="seconds"),
        value="SECONDS|inf",
        unit="s",
        unsaid=f"inf, in a list {LISTED_IMAGE_S:g}",
    ),
    "keep-open": Parameter(
        "at the end: no, end; yes, pause on the last frame; always, that after every medium of a list; "
        "black, hold black; auto, black in full screen, else no",
        Choice(KEEP_OPEN),
        "auto",
    ),
    "fade": Parameter(
        "from black at the start, to black at the end and for blackout", Number(0, 600), 0.0, "SECONDS", "s"
    ),
    "crossfade": Parameter("from a medium to the next", Number(0, 600), 0.0, "SECONDS", "s"),
    "volume": Parameter("loudness of the sound in percent; an error without audio", Number(0, 130), 100.0, "PERCENT"),
    "mute": Parameter("whether sound is off; an error without audio", FLAG, False),
    "brightness": Parameter("as in mpv", CONTROL, 0),
    "contrast": Parameter("as in mpv", CONTROL, 0),
    "gamma": Parameter("as in mpv", CONTROL, 0),
    "saturation": Parameter("as in mpv", CONTROL, 0),
    "black-level": Parameter("share of white that black asks for", Number(0, 0.5), 0.0, "SHARE"),
    "adapt": Parameter("percent of the light that may clip; 0 adapts nothing", Number(0, 100), 0.0, "PERCENT", "%"),
    "flicker": Parameter("weight of the frame before, against flicker", Number(0, 0.95), 0.0, "WEIGHT"),
    "clipping": Parameter("colour what clips", FLAG, False),
    "target-peak": Parameter(
        "cd/m² of HDR that the room's white stands for; 203 is graphics white",
        Number(50, 10_000, noun="cd/m²"),
        203.0,
        "NITS",
        "cd/m²",
    ),
    "hdr-peak": Parameter(
        "cd/m² of the brightest light of an HDR medium; auto, as it says itself, else 1000",
        Number(50, 10_000, words=("auto",), noun="cd/m²"),
        "auto",
        "auto|NITS",
        "cd/m²",
        "auto",
    ),
    "tone-mapping": Parameter(
        "how HDR is brought below white: bt.2390 bends what is bright, clip cuts it off",
        Choice(TONE_MAPPINGS),
        "bt.2390",
    ),
    "lut-type": Parameter(
        "native: a medium's codes become others of its own curve; conversion: of BT.1886 and BT.709",
        Choice(LUT_TYPES),
        "native",
    ),
    "viewpoint": Parameter(
        "where the viewer stands among the views of a room that was seen from several places",
        Places("all", FARTHEST, MOST_VIEWS),
        "all",
        "all|X[,Y]",
        unsaid="all: one viewer at every view",
    ),
    "test-card": Parameter("test card instead of the picture", Choice(("no", *CARDS)), "no"),
    "view": Parameter("what is shown", Choice(VIEWS), "projector"),
    "compensation": Parameter("whether the room is compensated", FLAG, True),
    "blackout": Parameter("show black", FLAG, False),
    "refine": Parameter(
        "steps of refinement a frame; auto, as many as the time of a frame leaves",
        STEPS,
        value="N|auto",
        unit="steps",
        unsaid="what the maps say, 4 to 16, in a window fewer\n"
        "where frames would come too late; 0: the correction map alone",
    ),
    "budget": Parameter(
        "milliseconds that drawing a frame may take: start and steps are what fits",
        Number(0.01, 1e6, words=("no",), noun="milliseconds"),
        "no",
        "MS",
        "ms",
        "no",
    ),
    "within": Parameter(
        "dB below the best picture that are allowed: start and steps are the least that keep it",
        Number(0.001, 100, words=("no",), noun="decibels"),
        "no",
        "DB",
        "dB",
        "no",
    ),
    "osd": Parameter(
        "what is written over the picture. on: what keys change, and in a window what went wrong; "
        "notices: that always; off: neither; auto: on in a window, off in full screen",
        Choice(OSD),
        "auto",
    ),
    "fullscreen": Parameter("whether the monitor is filled", FLAG, False),
}
