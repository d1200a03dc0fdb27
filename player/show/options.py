"""The table of the options of counterlight play.

Each row serves the command line, the settings file, keys, the property of remotes (if the option can change during a
show), and docs/player.md. command_line.py reads the options, keys.py binds the keys, and registry.py makes the
properties.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from counterlight.calibration import RADIANCE
from counterlight.media.decoding.devices import ANY, PROCESSOR, TYPES
from counterlight.pipeline.adjustments import KINDS, NEUTRAL
from counterlight.pipeline.device import BACKENDS, ENTRIES, SHADERS
from counterlight.pipeline.refinement import MOST_STEPS, STARTS
from counterlight.pipeline.room import DITHERS
from counterlight.pipeline.test_cards import CARDS
from counterlight.pipeline.value_types import FLAG, MANY, Anything, Choice, Kind, Number
from counterlight.pipeline.views import VIEWS
from counterlight.remote.addresses import LOOPBACK, PAGE_PORT, Address, parse_address
from counterlight.unattended.cues import PORT, read_address
from counterlight.unattended.hours import begins_at
from counterlight.unattended.supervisor import SAFE


@dataclass(frozen=True)
class Option:
    """One option.

    help : help text, without the default; empty for an option that only programs give.
    kind : the values that it takes.
    default : None if it depends on the media or the room.
    value : placeholder in --help.
    unit : unit shown after the value on the screen.
    stated : the default in words, if `default` is not enough.
    common : whether --help shows it.
    needs : "window" or "output" if the option has an effect only there.
    setting : whether the settings file may hold it. Flags that are no settings have no --no- form.
    several : whether it may be repeated.
    bare : value if the option is given without a value.
    keys : key -> command and its meaning.
    """

    help: str
    kind: Kind
    default: Any = None
    value: str = "N"
    unit: str = ""
    stated: str = ""
    common: bool = False
    needs: str = ""
    setting: bool = True
    several: bool = False
    bare: Any = None
    keys: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The help text with bounds and default."""
        bounds = self.kind.bounds if isinstance(self.kind, Number) and self.kind.high < MANY else ""
        notes = ", ".join(filter(None, (bounds, self._default)))
        return f"{self.help} ({notes})" if notes else self.help

    @property
    def _default(self) -> str:
        if self.stated:
            return f"default{':' if ' ' in self.stated else ''} {self.stated}"
        if self.default is None or self.default is False:
            return ""
        value = self.default
        return f"default {'yes' if value is True else value if isinstance(value, str) else f'{value:g}'}"


def _adjustment(field_name: str, text: str, **row: Any) -> Option:
    """Return the row of a field of Adjustments, which states its values and its default."""
    return Option(text, KINDS[field_name], getattr(NEUTRAL, field_name), **row)


def _add(name: str, step: int, lower: str, raise_: str) -> dict[str, tuple[str, str]]:
    """Return the two keys that lower and raise a value."""
    return {lower: (f"add {name} -{step}", name), raise_: (f"add {name} {step}", name)}


def _address(**defaults: Any) -> Anything:
    def read(word: str) -> tuple[str, int]:
        try:
            return read_address(word, **defaults)
        except ValueError:
            expected = "[HOST:]PORT" if "host" in defaults else "HOST[:PORT]"
            raise argparse.ArgumentTypeError(f"expected {expected}, found {word!r}") from None

    return Anything(parse=read)


def _times(word: str) -> tuple[float, ...]:
    try:
        times = tuple(float(each) for each in word.split(","))
    except ValueError:
        times = ()
    if not times or not all(0 < each < 1e3 for each in times):
        raise argparse.ArgumentTypeError(f"expected exposure times such as 0.01,0.04, found {word!r}")
    return times


def _device(word: str) -> str:
    if word.partition(":")[0] not in (PROCESSOR, ANY, *TYPES):
        raise argparse.ArgumentTypeError(f"expected {PROCESSOR}, {ANY} or one of {', '.join(TYPES)}, found {word!r}")
    return word


def _time_of_day(word: str) -> datetime:
    try:
        return begins_at(word, datetime.now())
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a time such as 20:00:00, found {word!r}") from None


_Window, _Output = partial(Option, needs="window"), partial(Option, needs="output")
LISTED_IMAGE_S = 5.0  # seconds that a picture in a list is shown by default
KEEP_OPEN = Choice(("auto", "no", "yes", "always", "black"))
OSD = Choice(("auto", "off", "on", "notices"))
TEXT, PATH = Anything(parse=str), Anything(parse=Path)
COUNT = partial(Number, high=1e9, whole=True)
GROUPS: dict[str, dict[str, Option]] = {
    "media": {
        "loop": Option("start again at the end", FLAG, False, common=True),
        "image-display-duration": _Window(
            "show still pictures this long",
            Number(0.01, 1e6, words=("inf",), noun="seconds"),
            value="SECONDS|inf",
            unit="s",
            stated=f"inf, or {LISTED_IMAGE_S:g} in a list",
            common=True,
        ),
        "fade": _Window("fade from and to black", Number(0, 600), 0.0, "SECONDS", "s", common=True),
        "crossfade": _Window("fade between two media", Number(0, 600), 0.0, "SECONDS", "s", common=True),
        "speed": _Window("play at this multiple of the normal speed", Number(0.01, 100), 1.0, "FACTOR"),
        "keep-open": _Window(
            "choose what happens at the end of the list. no: the player ends. yes: it pauses on the last frame. "
            "always: it pauses after every medium. black: it shows black. auto: black in full screen, otherwise no",
            KEEP_OPEN,
            "auto",
        ),
        "start": Option("start at this time of the first medium", Number(0, 1e9, noun="seconds"), 0.0, "SECONDS"),
        "playlist-start": _Window(
            "start with this medium of the list, counted from 0", COUNT(0, noun="a position in the list"), 0
        ),
        "frames": Option("stop after N frames", COUNT(1, noun="a number of frames"), stated="at the end"),
        "fps": Option(
            "set the frames per second of a numbered sequence",
            Number(1e-3, 1e3, noun="frames per second"),
            value="RATE",
            stated="25",
        ),
        "hwdec": _Window(
            f"decode films on a GPU: auto, {', '.join(TYPES)}; no: on the processor",
            Anything(parse=_device),
            PROCESSOR,
            "TYPE[:DEVICE]",
        ),
        "media-root": Option(
            "let lists and remotes name files below this folder; may be repeated",
            PATH,
            value="DIR",
            stated="folders of the lists and of the media",
            several=True,
        ),
        "allow-live": Option("let lists and remotes name streams (rtsp://, udp://)", FLAG, False),
    },
    "picture": {
        "view": Option(
            "choose the view to show",
            Choice(VIEWS),
            "projector",
            common=True,
            keys={"v": ("cycle view", "projector's picture, what the camera will see, split, …")},
        ),
        "brightness": _adjustment(
            "brightness", "adjust the brightness", common=True, keys=_add("brightness", 1, "3", "4")
        ),
        "contrast": _adjustment("contrast", "adjust the contrast", common=True, keys=_add("contrast", 1, "1", "2")),
        "gamma": _adjustment("gamma", "adjust the gamma", common=True, keys=_add("gamma", 1, "5", "6")),
        "saturation": _adjustment(
            "saturation", "adjust the saturation", common=True, keys=_add("saturation", 1, "7", "8")
        ),
        "black-level": _adjustment("black_level", "raise black to this share of white", value="SHARE"),
        "adapt": _adjustment(
            "adapt",
            "scale each frame so that at most this share of its light clips; 0: never",
            value="PERCENT",
            unit="%",
        ),
        "flicker": _adjustment(
            "flicker", "mix the previous frame in with this weight, against flicker", value="WEIGHT"
        ),
        "clipping": _adjustment(
            "clipping",
            "mark in colour what the projector cannot show",
            keys={"x": ("cycle clipping", "colour what clips")},
        ),
        "target-peak": _adjustment(
            "target_peak",
            "set the HDR luminance that the room's white stands for; 203 is graphics white",
            value="NITS",
            unit="cd/m²",
        ),
        "hdr-peak": _adjustment(
            "hdr_peak",
            "set the highest luminance of an HDR medium; auto: as its metadata says, otherwise 1000",
            value="auto|NITS",
            unit="cd/m²",
        ),
        "tone-mapping": _adjustment(
            "tone_mapping",
            "choose how HDR highlights are reduced to white. bt.2390: smoothly. clip: by cutting them off",
        ),
        "lut": Option("apply a colour table to the media", PATH, value="FILE.cube", stated="none"),
        "lut-type": _adjustment(
            "lut_type",
            "state what the table of --lut returns. native: colours in the medium's own space. conversion: BT.709 "
            "colours with the curve of BT.1886",
        ),
        "test-card": Option(
            "show a test card instead of the media",
            Choice(("no", *CARDS)),
            "no",
            keys={"t": ("cycle test-card", "test cards, sent as they are")},
        ),
    },
    "compensation": {
        "white": Option(
            "set the camera radiance of white; auto: what nine of ten camera pixels can reach",
            Number(*RADIANCE, words=("auto",), noun="a radiance"),
            "auto",
            "auto|LEVEL",
            common=True,
        ),
        "compensation": Option(
            "compensate for the room", FLAG, True, keys={"c": ("cycle compensation", "with and without compensation")}
        ),
        "refine": Option(
            "refine each frame in N steps; auto: in as many as its time allows",
            Number(0, MOST_STEPS, whole=True, words=("auto",), noun="a number of steps"),
            value="N|auto",
            unit="steps",
            stated="as the build found",
            common=True,
            keys={
                "[": ("multiply refine 0.5", "half the steps of refinement"),
                "]": ("multiply refine 2", "twice the steps"),
            },
        ),
        "refine-from": Option(
            "start the refinement from the frame before (changed by the correction map or by direct mapping), the "
            "correction map, direct mapping, or grey",
            Choice(STARTS),
            stated="as the build found",
        ),
        "budget": Option(
            "limit the time to draw a frame; start and steps are chosen to fit",
            Number(0.01, 1e6, words=("no",), noun="milliseconds"),
            "no",
            "MS",
            "ms",
        ),
        "within": Option(
            "allow frames to be this much below the best picture; start and steps are the least that achieve it",
            Number(0.001, 100, words=("no",), noun="decibels"),
            "no",
            "DB",
            "dB",
        ),
        "viewpoint": _adjustment(
            "viewpoint",
            "set the places of the viewers, in a room with several views; all: one viewer at every view",
            value="all|X[,Y]",
        ),
    },
    "window and sound": {
        "fullscreen": _Window(
            "fill the monitor",
            FLAG,
            False,
            common=True,
            keys={
                "f": ("cycle fullscreen", "fill the monitor"),
                "escape": ("set fullscreen no", "back to a window"),
                "ctrl+double-click": ("cycle fullscreen", "fill the monitor"),
            },
        ),
        "monitor": _Window(
            "show on this monitor of --list-monitors; may be repeated",
            TEXT,
            value="NAME|N",
            stated="the calibration's, or the first",
            common=True,
            several=True,
        ),
        "list-monitors": Option("list the monitors and exit", FLAG, False, common=True, setting=False),
        "any-size": _Window("fill a monitor that does not have the projector's size", FLAG, False),
        "vsync": _Window("wait for the display's refresh", FLAG, True),
        "audio": Option("play the sound, or copy it into the file of --output", FLAG, True),
        "volume": _Window(
            "set the volume of the sound",
            Number(0, 130),
            100.0,
            "PERCENT",
            common=True,
            keys=_add("volume", 2, "9", "0") | _add("volume", 2, "ctrl+wheel-down", "ctrl+wheel-up"),
        ),
        "mute": _Window("switch the sound off", FLAG, False, keys={"m": ("cycle mute", "mute")}),
        "blackout": _Window("show black", FLAG, False, keys={"b": ("cycle blackout", "black")}),
        "osd": _Window(
            "choose the text over the picture. on: changes by keys, and problems in a window. notices: problems "
            "always. off: none. auto: on in a window, off in full screen",
            OSD,
            "auto",
        ),
        "screenshot-directory": _Window(
            "save the pictures of key s in this folder", PATH, Path(), "DIR", stated="the current folder"
        ),
        "bits": _Window(
            "set the bits of a code value in a window; auto: as the monitors are set",
            Choice(("auto", "8", "10")),
            "auto",
        ),
    },
    "output to a file": {
        "output": Option(
            "render one medium into a file, without a window and without fades: .mp4, .mov, .webm, .mkv (lossless), "
            ".png, .exr, or name%05d.png",
            PATH,
            value="FILE",
            common=True,
            setting=False,
        ),
        "codec": _Output(
            "use this encoder of FFmpeg", TEXT, value="NAME", stated="libx264; libvpx-vp9 in .webm, ffv1 in .mkv"
        ),
        "pix-fmt": _Output(
            "use this pixel format of FFmpeg, such as yuv444p",
            TEXT,
            value="NAME",
            stated="yuv420p; yuv444p for odd sizes, bgr0 for ffv1",
        ),
        "crf": _Output("set FFmpeg's quality; lower is better", Number(0, 63), stated="14, visually lossless"),
        "segments": _Output(
            "render a film in N segments, each in its own process, and join them (docs/size.md)",
            Number(1, 999, whole=True, noun="a number of segments"),
            stated="1",
        ),
        "lead-in": _Output(
            "also divide shots; each segment then starts this many frames early",
            Number(0, 1e6, whole=True, noun="a number of frames"),
            value="FRAMES",
            stated="divide at cuts only",
        ),
        "cluster": _Output(
            "render the segments on the dask scheduler at HOST:PORT, or in N local processes with local:N (extra "
            "cluster, docs/size.md)",
            TEXT,
            value="ADDRESS",
            stated="in this process",
        ),
    },
    "running a show": {
        "supervise": Option("restart the player whenever it crashes or hangs", FLAG, False, common=True),
        "supervised": Option("", FLAG, False, setting=False),  # set only by the supervisor
        "at": _Window("start at this time of day; black until then", Anything(parse=_time_of_day), value="HH:MM:SS"),
        "schedule": _Window("play in the hours of this file; needs --supervise", PATH, value="FILE", common=True),
        "safe": Option(
            "show this after too many crashes: black, or the media without compensation", Choice(SAFE), "black"
        ),
        "heartbeat": _Window(
            "append a JSON line per second: frames, drops, memory, position (-: standard error)", TEXT, value="FILE|-"
        ),
        "check-every": Option(
            "check the room this often, between two media if possible, and correct what has moved",
            Number(1 / 60, 1e6, noun="minutes"),
            value="MINUTES",
        ),
        "check-with": Option(
            "pass these options to counterlight verify, for its camera and monitor; check-room uses them, too",
            TEXT,
            value="'OPTIONS'",
        ),
        "watch": _Window(
            "calibrate the room from the running film with this camera of acquire; may be repeated (docs/watch.md)",
            TEXT,
            value="CAMERA",
            common=True,
            several=True,
        ),
        "exposures": _Window(
            "set the exposure times of --watch in seconds", Anything(parse=_times), value="T,T…", stated="as calibrated"
        ),
        "watch-record": _Window(
            "keep what --watch sees and decides in this folder (docs/watch.md)",
            PATH,
            value="DIR",
            stated="nothing kept",
        ),
        "watch-freeze": _Window("keep the correction of --watch as it is", FLAG, False),
        "remote": _Window(
            "serve a page for browsers",
            Anything(parse=partial(parse_address, port=PAGE_PORT)),
            value="HOST:PORT",
            stated=f"{LOOPBACK}:{PAGE_PORT}; 0.0.0.0: to the whole network",
            common=True,
            bare=Address(LOOPBACK, PAGE_PORT),
        ),
        "osc": _Window(
            "accept Open Sound Control messages on this UDP port", Anything(parse=parse_address), value="[HOST:]PORT"
        ),
        "control": _Window("accept JSON commands on this socket, as in mpv's IPC", PATH, value="SOCKET"),
        "lead": _Window(
            "send the time of the show to followers on this UDP port", _address(host=""), value="[HOST:]PORT"
        ),
        "follow": _Window(
            f"follow the leader on another machine (default port {PORT})", _address(port=PORT), value="HOST[:PORT]"
        ),
    },
    "drawing and settings": {
        "backend": Option(
            "draw with OpenGL (gl) or on the processor (cpu); auto: gl with a GPU, --shader or --entries, else cpu",
            Choice(BACKENDS),
            "auto",
        ),
        "shader": Option(
            "multiply with the maps by these shaders of the GPU; auto: the faster, measured at startup",
            Choice(SHADERS),
            stated="auto in a window, otherwise fragment",
        ),
        "entries": Option(
            "use maps of 16 bytes per entry, or T and its transpose in words of 4 bytes; auto: the faster, measured at "
            "startup",
            Choice(ENTRIES),
            stated="auto in a window, otherwise 16",
        ),
        "dither": Option(
            "hide the steps between code values by a pattern, by noise, or not at all", Choice(DITHERS), "ordered"
        ),
        "stats": Option("write counts of frames and times in milliseconds to this file", PATH, value="FILE.json"),
        "config": Option(
            "read settings from this file",
            PATH,
            value="FILE",
            stated="~/.config/counterlight/player.toml",
            setting=False,
        ),
        "no-config": Option("read no settings file", FLAG, False, setting=False),
    },
}
OPTIONS = {name: row for rows in GROUPS.values() for name, row in rows.items()}
# options appended to a command line, so that a damaged room still shows media, from as few files as possible
WITHOUT_COMPENSATION = "--no-compensation", "--refine=0", "--budget=no", "--within=no", "--view=projector"
