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
    "speed": Parameter("play at this multiple of the normal speed", Number(0.01, 100), 1.0, "FACTOR"),
    "image-display-duration": Parameter(
        "show still pictures this long",
        Number(0.01, 1e6, words=("inf",), noun="seconds"),
        value="SECONDS|inf",
        unit="s",
        unsaid=f"inf, or {LISTED_IMAGE_S:g} in a list",
    ),
    "keep-open": Parameter(
        "choose what happens at the end of the list. no: the player ends. yes: it pauses on the last frame. "
        "always: it pauses after every medium. black: it shows black. auto: black in full screen, otherwise no",
        Choice(KEEP_OPEN),
        "auto",
    ),
    "fade": Parameter("fade from and to black", Number(0, 600), 0.0, "SECONDS", "s"),
    "crossfade": Parameter("fade between two media", Number(0, 600), 0.0, "SECONDS", "s"),
    "volume": Parameter("set the volume of the sound", Number(0, 130), 100.0, "PERCENT"),
    "mute": Parameter("switch the sound off", FLAG, False),
    "brightness": Parameter("adjust the brightness", CONTROL, 0),
    "contrast": Parameter("adjust the contrast", CONTROL, 0),
    "gamma": Parameter("adjust the gamma", CONTROL, 0),
    "saturation": Parameter("adjust the saturation", CONTROL, 0),
    "black-level": Parameter("raise black to this share of white", Number(0, 0.5), 0.0, "SHARE"),
    "adapt": Parameter(
        "scale each frame so that at most this share of its light clips; 0: never", Number(0, 100), 0.0, "PERCENT", "%"
    ),
    "flicker": Parameter("mix the previous frame in with this weight, against flicker", Number(0, 0.95), 0.0, "WEIGHT"),
    "clipping": Parameter("mark in colour what the projector cannot show", FLAG, False),
    "target-peak": Parameter(
        "set the HDR luminance that the room's white stands for; 203 is graphics white",
        Number(50, 10_000, noun="cd/m²"),
        203.0,
        "NITS",
        "cd/m²",
    ),
    "hdr-peak": Parameter(
        "set the highest luminance of an HDR medium; auto: as its metadata says, otherwise 1000",
        Number(50, 10_000, words=("auto",), noun="cd/m²"),
        "auto",
        "auto|NITS",
        "cd/m²",
        "auto",
    ),
    "tone-mapping": Parameter(
        "choose how HDR highlights are reduced to white. bt.2390: smoothly. clip: by cutting them off",
        Choice(TONE_MAPPINGS),
        "bt.2390",
    ),
    "lut-type": Parameter(
        "state what the table of --lut returns. native: colours in the medium's own space. conversion: BT.709 colours "
        "with the curve of BT.1886",
        Choice(LUT_TYPES),
        "native",
    ),
    "viewpoint": Parameter(
        "set the places of the viewers, in a room with several views; all: one viewer at every view",
        Places("all", FARTHEST, MOST_VIEWS),
        "all",
        "all|X[,Y]",
        unsaid="all",
    ),
    "test-card": Parameter("show a test card instead of the media", Choice(("no", *CARDS)), "no"),
    "view": Parameter("choose the view to show", Choice(VIEWS), "projector"),
    "compensation": Parameter("compensate for the room", FLAG, True),
    "blackout": Parameter("show black", FLAG, False),
    "refine": Parameter(
        "refine each frame in N steps; auto: in as many as its time allows",
        STEPS,
        value="N|auto",
        unit="steps",
        unsaid="as the build found",
    ),
    "budget": Parameter(
        "limit the time to draw a frame; start and steps are chosen to fit",
        Number(0.01, 1e6, words=("no",), noun="milliseconds"),
        "no",
        "MS",
        "ms",
        "no",
    ),
    "within": Parameter(
        "allow frames to be this much below the best picture; start and steps are the least that achieve it",
        Number(0.001, 100, words=("no",), noun="decibels"),
        "no",
        "DB",
        "dB",
        "no",
    ),
    "osd": Parameter(
        "choose the text over the picture. on: changes by keys, and problems in a window. notices: problems always. "
        "off: none. auto: on in a window, off in full screen",
        Choice(OSD),
        "auto",
    ),
    "fullscreen": Parameter("fill the monitor", FLAG, False),
}
