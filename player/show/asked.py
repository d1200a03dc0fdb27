"""What the options of counterlight play ask for, each worked out once for window and file."""

import argparse
import math
import shlex
from dataclasses import fields

from counterlight.errors import InputError
from counterlight.files.cube import read_cube
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.parameters import LISTED_IMAGE_S
from counterlight.pipeline.room import Room, read_room
from counterlight.show.governor import Governor
from counterlight.show.output import Coding, is_film

WINDOW_ONLY = (
    *("fullscreen", "monitor", "any_size", "vsync", "bits", "hwdec", "volume", "mute", "blackout", "osd"),
    *("screenshot_directory", "speed", "image_display_duration", "playlist_start", "keep_open", "fade"),
    *("crossfade", "control", "remote", "osc", "heartbeat", "lead", "follow", "at", "schedule"),
)


def adjustments_of(options: argparse.Namespace) -> Adjustments:
    """The viewer's settings among the options; InputError for a colour table that cannot be read."""
    values = {field.name: getattr(options, field.name) for field in fields(Adjustments) if field.name in options}
    return Adjustments(**values | {"lut": None if options.lut is None else read_cube(options.lut)})


def monitors_of(options: argparse.Namespace) -> list[str]:
    """The monitors that are named, one for each projector; settings may name a single one without a list."""
    return [options.monitor] if isinstance(options.monitor, str) else options.monitor or []


def room_of(options: argparse.Namespace) -> Room:
    """Read from its folder; InputError for what contradicts itself there or among the options."""
    white = None if options.white == "auto" else options.white
    if options.backend == "cpu" and options.path is not None:
        raise InputError(f"--path {options.path}: --backend cpu has no GPU to take it on; leave one of them out")
    path = options.path or ("auto" if options.output is None else "fragment")
    words = path in ("auto", "words", "compute-words")
    limited = options.budget != "no" or options.within != "no"
    if limited and options.refine not in (None, "auto"):
        raise InputError(
            f"--refine {options.refine}: --budget and --within choose the steps themselves; leave one of them out"
        )
    refine = "auto" if limited else options.refine
    return read_room(options.calibration, white, options.dither, refine, options.refine_from, words=words)


def governor_of(options: argparse.Namespace, room: Room, usual: int) -> Governor:
    """usual : steps if nobody says how many.  A start that was given stays."""
    offers = room.offers if options.refine_from is None else ()
    quick = room.maps.correction_in_steps < room.maps.direct_in_steps + 1
    told = {"budget": options.budget, "within": options.within, "start": room.start, "offers": offers, "quick": quick}
    return Governor(usual, options.refine, **told)


def image_display_duration(options: argparse.Namespace) -> float | None:
    """Seconds that a picture is shown; None for ever, which is what a single medium gets."""
    given = options.image_display_duration
    if given is None:
        return LISTED_IMAGE_S if len(options.media) > 1 else None
    return None if given == "inf" else float(given)


def check_of(options: argparse.Namespace) -> tuple[list[str], float] | None:
    """What a check of the room is told beside its folder, and every how many seconds one is due, inf for when it is
    asked for; None for no checks."""
    if options.check_every is None and options.check_with is None:
        return None
    if options.check_with is None:
        raise InputError("--check-every MINUTES needs --check-with '--camera CAMERA …'; give both")
    if options.output is not None:
        raise InputError("--check-with is for a window; with --output leave it out")
    try:
        words = shlex.split(options.check_with)
    except ValueError as error:
        raise InputError(f"--check-with {options.check_with}: {error}; quote it as for a shell") from None
    return words, math.inf if options.check_every is None else 60 * options.check_every


def coding_of(options: argparse.Namespace) -> Coding:
    """How a video is written."""
    return Coding(options.codec, options.pix_fmt, options.crf)


def one_medium(options: argparse.Namespace) -> Medium:
    """The medium to render into a file."""
    if len(options.media) != 1:
        raise InputError(f"--output renders one medium, found {len(options.media)}; give one")
    medium: Medium = options.media[0]
    return medium


def ignored(options: argparse.Namespace, info: MediaInfo) -> list[str]:
    """A line for options of the command line that mean nothing to what is rendered into a file."""
    lines = [f"--{name.replace('_', '-')}: is for a window, means nothing with --output" for name in WINDOW_ONLY]
    unused = [line for name, line in zip(WINDOW_ONLY, lines, strict=True) if name in options.given]
    if options.output is not None and not is_film(options.output):
        names = [name for name in ("segments", "cluster") if name in options.given]
        unused += [f"--{name}: {options.output} is a single picture" for name in names]
    if info.still:
        unused += [
            f"--{name}: {info.path} is a single picture"
            for name in ("frames", "start", "segments", "cluster")
            if name in options.given
        ]
    if "fps" in options.given and not options.media[0].is_sequence:
        unused.append(f"--fps: {info.path} is no numbered sequence and has a rate of its own")
    return unused
