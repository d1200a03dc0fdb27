"""Converts the options of counterlight play into objects, for a window and for a file alike."""

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
    """Return the viewer's settings among the options. Raises InputError for a colour table that cannot be read."""
    values = {field.name: getattr(options, field.name) for field in fields(Adjustments) if field.name in options}
    return Adjustments(**values | {"lut": None if options.lut is None else read_cube(options.lut)})


def monitors_of(options: argparse.Namespace) -> list[str]:
    """Return the named monitors, one per projector. A settings file may name a single monitor without a list."""
    return [options.monitor] if isinstance(options.monitor, str) else options.monitor or []


def room_of(options: argparse.Namespace) -> Room:
    """Read the room from its calibration folder. Raises InputError if the folder or the options are contradictory."""
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
    """Return the governor for the options. A start that the options give is kept.

    usual : steps if the options give no number.
    """
    offers = room.offers if options.refine_from is None else ()
    quick = room.maps.correction_in_steps < room.maps.direct_in_steps + 1
    told = {"budget": options.budget, "within": options.within, "start": room.start, "offers": offers, "quick": quick}
    return Governor(usual, options.refine, **told)


def image_display_duration(options: argparse.Namespace) -> float | None:
    """Return the seconds that a still picture is shown. None means without end, the default for a single medium."""
    given = options.image_display_duration
    if given is None:
        return LISTED_IMAGE_S if len(options.media) > 1 else None
    return None if given == "inf" else float(given)


def check_of(options: argparse.Namespace) -> tuple[list[str], float] | None:
    """Return the options for counterlight verify and the seconds between two checks of the room.

    The interval is inf if checks run on request only. The result is None if there are no checks.
    """
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
    """Return how a video is coded."""
    return Coding(options.codec, options.pix_fmt, options.crf)


def one_medium(options: argparse.Namespace) -> Medium:
    """Return the medium to render into a file. Raises InputError unless exactly one is given."""
    if len(options.media) != 1:
        raise InputError(f"--output renders one medium, found {len(options.media)}; give one")
    medium: Medium = options.media[0]
    return medium


def ignored(options: argparse.Namespace, info: MediaInfo) -> list[str]:
    """Return one line for each given option that has no effect when this medium is rendered into a file."""
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
