"""The commands and properties of a session (docs/player.md lists them): what keys, settings and remotes can do."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from counterlight.command import tell
from counterlight.pipeline.kinds import Anything, Choice, Number
from counterlight.pipeline.parameters import FLAG
from counterlight.show.output import write_picture
from counterlight.show.placing import Placing
from counterlight.show.playback import Playback
from counterlight.show.refining import refining
from counterlight.show.registry import Command, CommandError, Commands, Property, named
from counterlight.show.session import Session
from counterlight.show.stats_page import position
from counterlight.writing.replacing import replacing_file

ANY_NUMBER = Number(-1e9, 1e9)
TIME = Number(0, 1e9)
SEEKS = Choice(("relative", "absolute", "absolute-percent"))
LOADS = Choice(("replace", "append"))


def commands_of(session: Session) -> Commands:
    """Everything that can be done with a session."""
    actions = _Actions(session)
    return Commands(
        _commands(actions), {**_playing(session), **_adjustments(session), **_showing(session), **refining(session)}
    )


def _commands(do: "_Actions") -> dict[str, Command]:
    return {
        "seek": Command(
            "go forward, or back, or to a time or a percentage", do.seek, "SECONDS [relative|absolute|absolute-percent]"
        ),
        "frame-step": Command("show the next frame and pause", lambda: do.step(1)),
        "frame-back-step": Command("show the frame before and pause", lambda: do.step(-1)),
        "playlist-next": Command("play the next medium of the list", lambda: do.playlist(1)),
        "playlist-prev": Command("play the medium before", lambda: do.playlist(-1)),
        "loadfile": Command("play a medium or a list, or put it at the end", do.load, "PATH [replace|append]"),
        "ab-loop": Command("set point A, then B, then clear both", do.ab_loop),
        "screenshot": Command("save the view as a PNG picture; its path is the result", do.screenshot),
        "show-keys": Command("the page of keys, the next one if there are more, or none after the last", do.keys),
        "show-progress": Command("write where the medium is over the picture", do.progress),
        "show-text": Command("write a line over the picture", do.show_text, "TEXT [MILLISECONDS]"),
        "identify": Command("write its name on every monitor", do.identify),
        "reload": Command("read the maps and compile the shaders again; what is damaged changes nothing", do.reload),
        "place": Command("begin to place the picture in the camera's view", do.place),
        "place-move": Command("move the picture or the selected corner, in shares of the view", do.place_move, "DX DY"),
        "place-scale": Command("scale the picture about its middle", do.place_scale, "FACTOR"),
        "place-corner": Command("select the next corner, or the whole picture", do.place_corner),
        "place-undo": Command("take the last change back", do.place_undo),
        "place-fit": Command("as large as fits, as nobody had placed it", do.place_fit),
        "place-save": Command("keep the placement beside the calibration", do.place_save),
        "place-cancel": Command("leave the placement as it was", do.place_cancel),
        "quit": Command("end the player", do.quit),
    }


class _Actions:
    """What commands do; a text that is returned is also said on the screen when a key did it."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def seek(self, seconds: object, how: object = "relative") -> str:
        playback = _playback(self._session)
        info, amount, mode = playback.reader.info, ANY_NUMBER.read(seconds), SEEKS.read(how)
        if info.still or info.live:
            return ""
        if mode == "absolute-percent":
            if not info.duration_s:
                raise CommandError(f"seek: {info.path} does not say how long it is; give seconds")
            amount *= info.duration_s / 100
        playback.seek(amount + (playback.position_s if mode == "relative" else 0))
        self._session.stats.interrupted()
        return position(self._session)

    def step(self, direction: int) -> None:
        if not _playback(self._session).reader.info.still:
            _playback(self._session).step(direction)

    def playlist(self, by: int) -> str:
        session = self._session
        if not session.programme.go(by):
            raise CommandError("no further medium in the list" if by > 0 else "no medium before this one")
        return (
            f"{session.playlist.position + 1}/{len(session.playlist.media)} {Path(session.playlist.current.name).name}"
        )

    def load(self, path: object, how: object = "replace") -> str:
        medium = self._session.programme.load(str(path), replace=LOADS.read(how) == "replace")
        return Path(medium.name).name

    def ab_loop(self) -> str:
        playback = _playback(self._session)
        if playback.a_s is None:
            playback.a_s = playback.position_s
            return f"A-B loop from {playback.a_s:.2f} s"
        if playback.b_s is None and playback.position_s != playback.a_s:
            playback.b_s = playback.position_s
            first, last = sorted((playback.a_s, playback.b_s))
            return f"A-B loop {first:.2f} to {last:.2f} s"
        playback.a_s = playback.b_s = None
        return "A-B loop: off"

    def screenshot(self) -> str:
        session = self._session
        if not session.rendered:
            raise CommandError("screenshot: nothing has been shown yet")
        name = f"counterlight-{time.strftime('%Y%m%d-%H%M%S')}-{session.stats.frames:06d}.png"
        path = session.screenshots / name
        with replacing_file(path) as temporary:
            write_picture(temporary, session.renderer)
        tell(f"saved {path}", sys.stdout)
        return str(path)

    def keys(self) -> None:
        self._session.help_page += 1
        self._session.changed()

    def progress(self) -> None:
        _playback(self._session)
        self._session.say(position(self._session))

    def show_text(self, text: object, milliseconds: object = 1000) -> None:
        self._session.say(str(text), TIME.read(milliseconds) / 1000)

    def identify(self) -> str:
        self._session.display.identify()
        return f"this is {self._session.display.monitor}"

    def reload(self) -> str:
        """Whatever goes wrong with files, shaders or memory, the show goes on with what it has."""
        session = self._session
        try:
            session.replace_renderer(session.room.reload())
        except Exception as error:  # an edited shader can go wrong in any way
            line = session.not_reloaded(error)
            session.stats.notice(line)
            raise CommandError(line) from None
        return "maps and shaders reloaded"

    def place(self) -> None:
        session = self._session
        if session.placing is None:
            session.placing = Placing(session.adjustments.corners or self._fitted(), session.adjustments.corners)

    def place_move(self, dx: object, dy: object) -> None:
        placing = self._placing()
        placing.move(ANY_NUMBER.read(dx), ANY_NUMBER.read(dy))
        self._apply(placing)

    def place_scale(self, factor: object) -> None:
        placing = self._placing()
        placing.scale(Number(0.01, 100).read(factor))
        self._apply(placing)

    def place_corner(self) -> str:
        placing = self._placing()
        placing.select_next()
        return placing.selected

    def place_undo(self) -> str:
        placing = self._placing()
        if not placing.undo():
            return "nothing to take back"
        self._apply(placing)
        return ""

    def place_fit(self) -> None:
        placing = self._placing()
        placing.put(self._fitted())
        self._apply(placing)

    def place_save(self) -> str:
        session, placing = self._session, self._placing()
        corners = None if placing.corners == self._fitted() else placing.corners
        saved = session.room.keep(corners)
        session.adjust(replace(session.adjustments, corners=corners))
        session.placing = None
        return "placement: as large as fits" if corners is None else f"saved {saved}"

    def place_cancel(self) -> str:
        session, placing = self._session, self._placing()
        session.adjust(replace(session.adjustments, corners=placing.before))
        session.placing = None
        return "placement as it was"

    def quit(self) -> None:
        self._session.done = True

    def _placing(self) -> Placing:
        if self._session.placing is None:
            raise CommandError("the picture is not being placed; begin with: place")
        return self._session.placing

    def _fitted(self) -> Any:
        return self._session.room.fit(_playback(self._session).reader.info.format)

    def _apply(self, placing: Placing) -> None:
        self._session.adjust(replace(self._session.adjustments, corners=placing.corners))


def _attribute(of: Callable[[], Any], name: str) -> tuple[Callable[[], Any], Callable[[Any], None]]:
    """What reads and what sets an attribute of what there is then."""
    return lambda: getattr(of(), name), lambda value: setattr(of(), name, value)


def _playing(session: Session) -> dict[str, Property]:
    """Of the medium and the list."""

    def now() -> Playback:
        return _playback(session)

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
        "pause": Property("whether time stands still", *_attribute(manner, "paused"), FLAG),
        "speed": named("speed", *_attribute(manner, "speed")),
        "time-pos": Property(
            "seconds from the medium's beginning", lambda: now().position_s, lambda t: now().seek(t), TIME, "s"
        ),
        "duration": Property("seconds, null if unknown or a still", lambda: now().reader.info.duration_s),
        "path": Property("the medium that plays", lambda: str(now().reader.info.path)),
        "playlist": Property("the media of the list", lambda: [medium.name for medium in playlist.media]),
        "playlist-pos": Property(
            "position in the list, of what plays or is being opened",
            lambda: playlist.position,
            go_to,
            Number(0, 1e6, whole=True),
        ),
        "playlist-playing-pos": Property("position of what plays", lambda: session.programme.on),
        "loop-file": Property("begin the medium again at its end", *_attribute(manner, "loop"), FLAG),
        "loop-playlist": Property("begin the list again at its end", *_attribute(lambda: playlist, "loop"), FLAG),
        "ab-loop-a": _point(now, "a_s", "where the A-B loop begins"),
        "ab-loop-b": _point(now, "b_s", "where it ends; the end of the medium if that comes before"),
        "image-display-duration": named(
            "image-display-duration",
            lambda: "inf" if session.image_display_duration is None else session.image_display_duration,
            hold,
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
    """Of counterlight.pipeline.adjustments.Adjustments."""

    def field(name: str) -> Property:
        attribute = name.replace("-", "_")
        return named(name, lambda: getattr(session.adjustments, attribute), lambda value: put(**{attribute: value}))

    def put(**changed: Any) -> None:
        session.adjust(replace(session.adjustments, **changed))

    def corners() -> Any:
        found = session.adjustments.corners
        return None if found is None else [list(corner) for corner in found]

    names = "brightness", "contrast", "gamma", "saturation", "black-level", "adapt", "flicker", "clipping"
    return {name: field(name) for name in names} | {
        "test-card": named(
            "test-card",
            lambda: session.adjustments.card or "no",
            lambda card: put(card=None if card == "no" else card),
        ),
        "corners": Property(
            "corners of the picture in the camera's view from the upper left, clockwise, in shares of it; "
            "null fits the picture in",
            corners,
            lambda value: put(corners=_corners(value)),
            Anything("null, four pairs"),
        ),
    }


def _showing(session: Session) -> dict[str, Property]:
    """Of the window, the view and the pages."""

    def put(name: str, value: object) -> None:
        setattr(session, name, value)
        session.changed()

    def attribute(name: str) -> tuple[Callable[[], Any], Callable[[Any], None]]:
        return lambda: getattr(session, name), lambda value: put(name, value)

    display = session.display

    return {
        **{name: named(name, *attribute(name)) for name in ("view", "compensation", "blackout")},
        "stats": Property("the page of statistics", *attribute("show_stats"), FLAG),
        "help": Property("the page of keys", lambda: session.help_page > 0, lambda on: put("help_page", int(on)), FLAG),
        "osd": named("osd", *attribute("osd")),
        "message": Property("what the screen says, empty once it has faded", lambda: session.message.text),
        "placing": Property("whether the picture is being placed", lambda: session.placing is not None),
        "fullscreen": named("fullscreen", lambda: display.fullscreen, display.set_fullscreen),
        "monitor": Property(
            "where the window is; another one moves it",
            lambda: display.monitor,
            display.move_to,
            Anything("a name or number"),
        ),
        "frames": Property("frames shown", lambda: session.stats.frames),
        "dropped": Property("frames dropped", lambda: session.stats.dropped),
        "fps": Property("frames a second on the screen", lambda: session.stats.frames_per_second),
    }


def _playback(session: Session) -> Playback:
    if session.playback is None:
        raise CommandError("no medium is open")
    return session.playback


def _corners(value: Any) -> Any:
    if value is None or value == "no":
        return None
    try:
        a, b, c, d = ((float(x), float(y)) for x, y in value)
    except (TypeError, ValueError):
        raise CommandError(f"corners: expected four pairs of numbers or null, found {value!r}") from None
    return a, b, c, d
