"""Properties of a session that can be read and set. Refinement comes last. docs/player.md lists them."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Any

from counterlight.errors import InputError
from counterlight.files.cube import Cube, read_cube
from counterlight.pipeline.adjustments import KINDS
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.value_types import FLAG, Anything, Number
from counterlight.show.lookup import LookUp
from counterlight.show.playback import Playback
from counterlight.show.registry import CommandError, Property, named
from counterlight.show.session import Session
from counterlight.show.stats import DRAWING, STAGES
from counterlight.unattended.pjlink import Lamps

TIME = Number(0, 1e9)
UNREFINABLE = "no refinement: the maps were built without it; counterlight build adds it"
READ_S = 1.0  # longest time that the show waits for a disk


def properties_of(session: Session, checking: Callable[[], bool], lamps: Lamps | None) -> dict[str, Property]:
    """Return all properties of a session.

    checking : whether a check of the room is running.
    lamps : projectors that can be switched.
    """
    parts = _playing, _adjustments, look_properties, _showing, refining
    return {name: each for part in parts for name, each in part(session).items()} | _facts(session, checking, lamps)


def playback_of(session: Session) -> Playback:
    """Return the session's playback. Raises CommandError while no medium is open."""
    if session.playback is None:
        raise CommandError("no medium is open")
    return session.playback


def _attribute(of: Callable[[], Any], name: str) -> tuple[Callable[[], Any], Callable[[Any], None]]:
    """Return a getter and a setter for attribute `name` of the object that `of` returns at the time of the call."""
    return lambda: getattr(of(), name), lambda value: setattr(of(), name, value)


def _playing(session: Session) -> dict[str, Property]:
    """Properties of the medium and the list."""

    def now() -> Playback:
        return playback_of(session)

    def audio() -> Any:
        if session.audio is None:
            raise CommandError("no audio")
        return session.audio

    def go_to(index: int) -> None:
        if not 0 <= index < len(session.playlist.media):
            raise CommandError(f"playlist-pos: expected 0 to {len(session.playlist.media) - 1}, found {index}")
        session.programme.select(index)

    def hold(seconds: float | str) -> None:
        session.image_display_duration = None if seconds == "inf" else float(seconds)
        if session.playback is not None:
            session.playback.hold_s = session.image_display_duration

    def manner() -> Any:
        return session.manner

    playlist = session.playlist
    return {
        "pause": Property("pause the show", *_attribute(manner, "paused"), FLAG),
        "speed": named("speed", *_attribute(manner, "speed")),
        "time-pos": Property(
            "position in the medium, from its beginning", lambda: now().position_s, lambda t: now().seek(t), TIME, "s"
        ),
        "duration": Property(
            "seconds; null if unknown or a still picture",
            lambda: now().reader.info.duration_s,
        ),
        "path": Property("path of the medium that plays", lambda: str(now().reader.info.path)),
        "playlist": Property("list of the media", lambda: [medium.name for medium in playlist.media]),
        "playlist-pos": Property(
            "position in the list of the medium that plays or opens",
            lambda: playlist.position,
            go_to,
            Number(0, 1e6, whole=True),
        ),
        "playlist-playing-pos": Property("position in the list of the medium that plays", lambda: session.programme.on),
        "loop-file": Property("repeat the medium", *_attribute(manner, "loop"), FLAG),
        "loop-playlist": Property("repeat the list", *_attribute(lambda: playlist, "loop"), FLAG),
        "ab-loop-a": _point(now, "a_s", "start of the A-B loop"),
        "ab-loop-b": _point(now, "b_s", "end of the A-B loop, at most the end of the medium"),
        "image-display-duration": named(
            "image-display-duration",
            lambda: "inf" if session.image_display_duration is None else session.image_display_duration,
            hold,
        ),
        "keep-open": named("keep-open", *_attribute(lambda: session, "keep_open")),
        "fade": named("fade", *_attribute(lambda: session.fade, "seconds")),
        "crossfade": named("crossfade", *_attribute(lambda: session, "crossfade_s")),
        "eof-reached": Property("yes if the end of the list is held (keep-open)", lambda: session.programme.at_end),
        "in-step": Property(
            "state of a leader or a follower; null for other players", lambda: session.stats.facts.get("in_step")
        ),
        "volume": named("volume", *_attribute(audio, "volume")),
        "mute": named("mute", *_attribute(audio, "mute")),
    }


def _point(now: Callable[[], Playback], name: str, text: str) -> Property:
    def read() -> float | str:
        value = getattr(now(), name)
        return "no" if value is None else float(value)

    return Property(
        text,
        read,
        lambda value: setattr(now(), name, None if value == "no" else value),
        Number(0, 1e9, words=("no",)),
        "s",
    )


def _adjustments(session: Session) -> dict[str, Property]:
    """Properties that set counterlight.pipeline.adjustments.Adjustments."""

    def field(name: str) -> Property:
        attribute = name.replace("-", "_")
        return named(name, lambda: getattr(session.adjustments, attribute), lambda value: put(**{attribute: value}))

    def put(**changed: Any) -> None:
        session.adjust(replace(session.adjustments, **changed))

    def corners() -> Any:
        found = session.adjustments.corners
        return None if found is None else [list(corner) for corner in found]

    names = [name.replace("_", "-") for name in KINDS if name != "card"]
    return {name: field(name) for name in names} | {
        "test-card": named(
            "test-card",
            lambda: session.adjustments.card or "no",
            lambda card: put(card=None if card == "no" else card),
        ),
        "corners": Property(
            "corners of the picture in the camera's view, clockwise from the upper left, in shares of the view; "
            "null: fit the picture",
            corners,
            lambda value: put(corners=_corners(value)),
            Anything("null, four pairs"),
        ),
    }


def _showing(session: Session) -> dict[str, Property]:
    """Properties of the window, the view and the pages."""

    def put(name: str, value: object) -> None:
        setattr(session, name, value)
        session.changed()

    def attribute(name: str) -> tuple[Callable[[], Any], Callable[[Any], None]]:
        return lambda: getattr(session, name), lambda value: put(name, value)

    display = session.display

    return {
        **{name: named(name, *attribute(name)) for name in ("view", "compensation", "blackout")},
        "stats": Property("show the page of statistics", *attribute("show_stats"), FLAG),
        "help": Property("show the keys", lambda: session.help_page > 0, lambda on: put("help_page", int(on)), FLAG),
        "osd": named("osd", *attribute("osd")),
        "message": Property("message on the screen; empty after it has faded", lambda: session.message.text),
        "placing": Property("yes while the picture is being placed", lambda: session.placing is not None),
        "fullscreen": named("fullscreen", lambda: display.fullscreen, display.set_fullscreen),
        "monitor": Property(
            "monitor of the window; a new value moves the window",
            lambda: display.monitor,
            display.move_to,
            Anything("a name or number"),
        ),
    }


def _facts(session: Session, checking: Callable[[], bool], lamps: Lamps | None) -> dict[str, Property]:
    """Read-only properties that describe how the show runs."""

    stats = session.stats

    def recent() -> dict[str, Any]:
        requested, shown = session.rates
        return stats.recent(session.clock()) | {"requested": round(requested, 2), "fps": round(shown, 2)}

    return {
        "frames": Property("number of frames shown", lambda: stats.frames),
        "dropped": Property("number of frames dropped", lambda: stats.dropped),
        "recent": Property(
            "object for the last 10 s: frames shown, late (the next frame was due) and dropped; frame rates of the "
            "medium and of the screen",
            recent,
        ),
        "events": Property("objects for the last 20 problems: text, and time in seconds since 1970", stats.events),
        "fps": Property("frames per second on the screen", lambda: stats.frames_per_second),
        "stage-ms": Property(
            "object with the median milliseconds of each stage of a frame",
            lambda: {stage: round(stats.median_ms(stage), 3) for stage in (*STAGES, *DRAWING) if stats.has(stage)},
        ),
        "late-frames": Property(
            "numbers of frames that were late by less than 1, 2, 4, 8, 16, 32 and 64 ms, and by more",
            lambda: list(stats.late_counts),
        ),
        "notices": Property("last 20 problems that did not stop the show", stats.latest_notices),
        "drift": Property("result of the last check of the room; null without a check", lambda: session.room.drifted),
        "checking": Property("yes while a check of the room is running", checking),
        "projectors": Property(
            "projectors of --schedule: address, power, lamp hours, faults, trouble; null without --schedule",
            lambda: None if lamps is None else lamps.told(),
        ),
    }


def _corners(value: Any) -> Any:
    if value is None or value == "no":
        return None
    try:
        a, b, c, d = ((float(x), float(y)) for x, y in value)
    except (TypeError, ValueError):
        raise CommandError(f"corners: expected four pairs of numbers or null, found {value!r}") from None
    return a, b, c, d


def refining(session: Session) -> dict[str, Property]:
    """Return the properties of a session's refinement."""
    governor, appraisal = session.governor, session.appraisal

    def wants(what: Any) -> None:
        if what not in (0, "no") and not session.room.refinable:
            raise CommandError(UNREFINABLE)
        session.changed()

    def refine(steps: Any) -> None:
        wants(steps)
        governor.set_refine(steps)

    def budget(milliseconds: Any) -> None:
        wants(milliseconds)
        governor.set_budget(milliseconds)

    def within(decibels: Any) -> None:
        wants(decibels)
        governor.set_within(decibels)

    def certified(value: Callable[[Certificate], float]) -> float | None:
        certificate = session.certificate()
        return None if certificate is None else value(certificate)

    def below_optimum() -> float | None:
        found = appraisal.ask()
        return None if found is None else found.decibels

    def doubling() -> dict[str, float | None] | None:
        found = appraisal.ask()
        return (
            None
            if found is None
            else {"steps": found.further, "db": found.doubling, "ms": governor.took_ms(found.further)}
        )

    psnr = session.room.psnr
    return {
        "refine": named("refine", lambda: governor.refine, refine),
        "budget": named("budget", lambda: governor.budget, budget),
        "within": named("within", lambda: governor.within, within),
        "steps": Property("number of refinement steps of the picture on the screen", lambda: session.steps_made),
        "step-ms": Property("milliseconds per refinement step; null if unknown", lambda: governor.took_ms(1)),
        "below-optimum": Property(
            "estimated distance to the best picture in dB; null while unknown", below_optimum, costly=True
        ),
        "doubling": Property(
            "object with the gain in dB and the cost in ms of twice as many steps; null while unknown",
            doubling,
            costly=True,
        ),
        "gap": Property(
            "relative gap to the best picture; null if unknown",
            lambda: certified(attrgetter("relative")),
            costly=True,
        ),
        "psnr": Property(
            "PSNR of the predicted camera picture against the target over lit pixels, in dB; null if unknown",
            lambda: certified(psnr),
            costly=True,
        ),
    }


def look_properties(session: Session) -> dict[str, Property]:
    def name() -> str:
        cube = session.adjustments.lut
        return "no" if cube is None else str(cube.path)

    def put(name: object) -> None:
        if not isinstance(name, str):
            raise CommandError(f"lut: expected the name of a .cube file or no, found {name!r}")
        cube = None if name in ("", "no") else _read(partial(session.programme.opener.cube, name))
        session.adjust(replace(session.adjustments, lut=cube))

    text = "colour table for the media, a .cube file"
    return {"lut": Property(text, name, put, Anything("no, a path"))}


def read_again(cube: Cube) -> Cube:
    """Read the table's file again. Raises InputError if the file is damaged."""
    return _read(partial(read_cube, cube.path))


def _read(read: Callable[[], Cube]) -> Cube:
    found = LookUp(read).result(READ_S)
    if found is None:
        raise InputError(f"lut: not read within {READ_S:g} s; copy it to a local disk")
    return found
