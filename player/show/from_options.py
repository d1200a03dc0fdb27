"""Converts the options of counterlight play into objects, for a window and for a file alike."""

import argparse
import math
import shlex
from collections.abc import Sequence
from dataclasses import fields

from counterlight.calibration import Device
from counterlight.errors import InputError
from counterlight.files.cube import read_cube
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.device import EVERYWHERE, GpuPath
from counterlight.pipeline.room import Room, read_room
from counterlight.show.beginning import Playing
from counterlight.show.governor import Governor, Steps
from counterlight.show.options import LISTED_IMAGE_S


def adjustments_of(options: argparse.Namespace) -> Adjustments:
    """Return the viewer's settings among the options. Raises InputError for a colour table that cannot be read."""
    values = {field.name: getattr(options, field.name) for field in fields(Adjustments) if field.name in options}
    card = None if options.test_card == "no" else options.test_card
    return Adjustments(**values | {"lut": None if options.lut is None else read_cube(options.lut), "card": card})


def monitors_of(options: argparse.Namespace) -> list[str]:
    """Return the named monitors, one per projector. A settings file may name a single monitor without a list."""
    return [options.monitor] if isinstance(options.monitor, str) else options.monitor or []


def names_of_monitors(options: argparse.Namespace, projectors: Sequence[Device]) -> list[str]:
    """Return the name or number of each projector's monitor."""
    names = [projector.monitor or str(number) for number, projector in enumerate(projectors)]
    return monitors_of(options) or names


def cameras_of(options: argparse.Namespace) -> list[str]:
    """Return the cameras of --watch. A settings file may name a single camera without a list."""
    return [options.watch] if isinstance(options.watch, str) else options.watch or []


def room_of(options: argparse.Namespace) -> Room:
    """Read the room from its calibration folder. Raises InputError if the folder or the options are contradictory."""
    white = None if options.white == "auto" else options.white
    for name in ("shader", "entries"):
        value = getattr(options, name)
        if options.backend == "cpu" and value is not None:
            raise InputError(f"--{name} {value}: --backend cpu has no GPU to use it; leave one of them out")
    words = options.backend != "cpu" and path_of(options).entries != "16"
    steps, start = steps_of(options), options.refine_from
    room = read_room(options.calibration, white, options.dither, start, refinement=steps != 0, words=words)
    if steps != 0 and (steps or start) and any(view.maps.refinement is None for view in room.views):
        raise InputError(
            f"{options.calibration}: its maps were built without what refinement needs; rebuild them with: "
            f"counterlight build {options.calibration}, or leave out --refine, --refine-from, --budget and --within"
        )
    return room


def path_of(options: argparse.Namespace) -> GpuPath:
    """Return how a GPU multiplies; words of 4 bytes only if refinement can use them.

    By default a window measures and keeps the fastest path; a file uses a fixed path, so that its result repeats.
    """
    usual = GpuPath("auto", "auto") if options.output is None else EVERYWHERE
    entries = "16" if _uncompensated(options) else options.entries or usual.entries
    return GpuPath(options.shader or usual.shader, entries)


def _uncompensated(options: argparse.Namespace) -> bool:
    """Whether the show begins, and stays, without refinement. Options for refinement then have no effect."""
    return options.refine == 0 and not options.compensation


def backend_of(options: argparse.Namespace) -> str:
    """Return the backend: OpenGL if an option selects shaders of OpenGL, otherwise the one that --backend names."""
    chosen: str = options.backend
    return "gl" if chosen == "auto" and (options.shader or options.entries) else chosen


def steps_of(options: argparse.Namespace) -> Steps | None:
    """Return the steps of a frame, None for the room's default. Raises InputError if options contradict each other."""
    steps: Steps | None = options.refine
    if options.budget != "no" or options.within != "no":
        if steps not in (None, "auto"):
            raise InputError(
                f"--refine {steps}: --budget and --within choose the steps themselves; leave one of them out"
            )
        return "auto"
    if steps == "auto" and options.output is not None:
        raise InputError(
            "--refine auto is for a window: a file has no time to keep; give a number of steps, --budget or --within"
        )
    if steps == 0 and options.refine_from is not None and not _uncompensated(options):
        start = options.refine_from
        raise InputError(
            f"--refine-from {start}: --refine 0 makes no step that could start there; leave one of them out"
        )
    return steps


def governor_of(options: argparse.Namespace, room: Room, usual: int) -> Governor:
    """Return the governor for the options. A start given by the options is kept.

    usual : steps if the options give no number.
    """
    offers = room.offers if options.refine_from is None else ()
    quick = room.maps.correction_in_steps < room.maps.direct_in_steps + 1
    limits = {"budget": options.budget, "within": options.within, "start": room.start, "offers": offers, "quick": quick}
    return Governor(usual, options.refine, **limits)


def playing_of(options: argparse.Namespace) -> Playing:
    """Return how the media are played."""
    return Playing(
        loop_file=options.loop and len(options.media) == 1,
        speed=options.speed,
        start_s=options.start,
        image_display_duration=image_display_duration(options),
        keep_open=options.keep_open,
        fade_s=options.fade,
        crossfade_s=options.crossfade,
    )


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
