"""The commands and properties of a session (docs/player.md lists them): what keys, settings and remotes can do."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from counterlight.adjustments import CONTROL, MOST_BLACK, MOST_FLICKER
from counterlight.command import tell
from counterlight.kinds import ANYTHING, Choice, Flag, Number
from counterlight.output import write_picture
from counterlight.refinement import MOST_STEPS
from counterlight.renderer import VIEWS
from counterlight.show.placing import Placing
from counterlight.show.playback import Playback
from counterlight.show.registry import Command, CommandError, Commands, Property
from counterlight.show.session import Session
from counterlight.show.stats_page import position
from counterlight.test_cards import CARDS
from counterlight.writing.replacing import replacing_file

ANY_NUMBER = Number(-1e9, 1e9)
TIME = Number(0, 1e9)
SEEKS = Choice(("relative", "absolute", "absolute-percent"))
LOADS = Choice(("replace", "append"))


def commands_of(session: Session) -> Commands:
    """Everything that can be done with a session."""
    actions = _Actions(session)
    return Commands(_commands(actions), {**_playing(session), **_picture(session), **_showing(session)})


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
        if not session.playlist.loop and not 0 <= session.playlist.position + by < len(session.playlist.media):
            raise CommandError("no further medium in the list" if by > 0 else "no medium before this one")
        session.programme.go(by)
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
        if playback.b_s is None and playback.position_s > playback.a_s:
            playback.b_s = playback.position_s
            return f"A-B loop {playback.a_s:.2f} to {playback.b_s:.2f} s"
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


def _playing(session: Session) -> dict[str, Property]:
    """Of the medium and the list."""

    def now() -> Playback:
        return _playback(session)

    def manner(name: str, kind: Any, text: str) -> Property:
        return Property(
            text, lambda: getattr(session.manner, name), lambda value: setattr(session.manner, name, value), kind
        )

    def go_to(index: int) -> None:
        if not 0 <= index < len(session.playlist.media):
            raise CommandError(f"playlist-pos: expected 0 to {len(session.playlist.media) - 1}, found {index}")
        session.programme.select(index)

    def hold(seconds: float | str) -> None:
        session.image_display_duration = None if seconds == "inf" else float(seconds)
        if session.playback is not None:
            session.playback.hold_s = session.image_display_duration

    playlist = session.playlist
    return {
        "pause": manner("paused", Flag(), "whether time stands still"),
        "speed": manner("speed", Number(0.01, 100), "media seconds a second"),
        "time-pos": Property(
            "seconds from the beginning", lambda: now().position_s, lambda t: now().seek(t), TIME, "s"
        ),
        "duration": Property("seconds, null if unknown or a still", lambda: now().reader.info.duration_s),
        "path": Property("the medium that plays", lambda: str(now().reader.info.path)),
        "playlist": Property("the media of the list", lambda: [medium.name for medium in playlist.media]),
        "playlist-pos": Property(
            "position in the list, from 0, of what plays or is being opened",
            lambda: playlist.position,
            go_to,
            Number(0, 1e6, whole=True),
        ),
        "playlist-playing-pos": Property("position of what plays", lambda: session.programme.on),
        "loop-file": manner("loop", Flag(), "begin the medium again at its end"),
        "loop-playlist": Property(
            "begin the list again at its end",
            lambda: playlist.loop,
            lambda on: setattr(playlist, "loop", on),
            Flag(),
        ),
        "ab-loop-a": _point(now, "a_s", "where the A-B loop begins, no or seconds"),
        "ab-loop-b": _point(now, "b_s", "where it ends, no or seconds"),
        "image-display-duration": Property(
            "seconds that a picture is shown, or inf",
            lambda: "inf" if session.image_display_duration is None else session.image_display_duration,
            hold,
            Number(0.01, 1e6, words=("inf",)),
            "s",
        ),
        "volume": _sound(session, "volume", Number(0, 130), "loudness in percent; an error without audio"),
        "mute": _sound(session, "mute", Flag(), "whether sound is off; an error without audio"),
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


def _sound(session: Session, name: str, kind: Any, text: str) -> Property:
    def audio() -> Any:
        if session.audio is None:
            raise CommandError("no audio")
        return session.audio

    return Property(text, lambda: getattr(audio(), name), lambda value: setattr(audio(), name, value), kind)


def _picture(session: Session) -> dict[str, Property]:
    """Of counterlight.adjustments.Adjustments."""

    def field(name: str, kind: Any, text: str, unit: str = "") -> Property:
        return Property(
            text,
            lambda: getattr(session.adjustments, name),
            lambda value: session.adjust(replace(session.adjustments, **{name: value})),
            kind,
            unit,
        )

    control = Number(-CONTROL, CONTROL, whole=True)
    return {
        "brightness": field("brightness", control, "-100 to 100"),
        "contrast": field("contrast", control, "-100 to 100"),
        "gamma": field("gamma", control, "-100 to 100"),
        "saturation": field("saturation", control, "-100 to 100"),
        "black-level": field("black_level", Number(0, MOST_BLACK), "share of white that black asks for"),
        "adapt": field("adapt", Number(0, 100), "percent of the light that may clip; 0 adapts nothing", "%"),
        "flicker": field("flicker", Number(0, MOST_FLICKER), "weight of the frame before, against flicker"),
        "clipping": field("clipping", Flag(), "colour what clips"),
        "test-card": Property(
            f"{', '.join(CARDS)}, or no",
            lambda: session.adjustments.card or "no",
            lambda card: session.adjust(replace(session.adjustments, card=None if card == "no" else card)),
            Choice(("no", *CARDS)),
        ),
        "corners": Property(
            "of the picture in the camera's view, four pairs from its upper left; null fits it in",
            lambda: (
                None
                if session.adjustments.corners is None
                else [list(corner) for corner in session.adjustments.corners]
            ),
            lambda corners: session.adjust(replace(session.adjustments, corners=_corners(corners))),
            ANYTHING,
        ),
    }


def _showing(session: Session) -> dict[str, Property]:
    """Of the window, the view and the pages."""

    def attribute(name: str, kind: Any, text: str) -> Property:
        def put(value: object) -> None:
            setattr(session, name, value)
            session.changed()

        return Property(text, lambda: getattr(session, name), put, kind)

    display = session.display

    def gap() -> float | None:
        certificate = session.certificate()
        return None if certificate is None else certificate.relative

    def psnr() -> float | None:
        certificate = session.certificate()
        return None if certificate is None else session.room.psnr(certificate)

    def refine(steps: Any) -> None:
        if steps and not session.room.refinable:
            raise CommandError("no refinement: the maps were built without it; counterlight build adds it")
        session.set_refine(steps)

    return {
        "view": attribute("view", Choice(VIEWS), ", ".join(VIEWS)),
        "compensation": attribute("compensation", Flag(), "whether the room is compensated"),
        "blackout": attribute("blackout", Flag(), "show black"),
        "refine": Property(
            "steps of refinement a frame, or auto",
            lambda: session.refine,
            refine,
            Number(0, MOST_STEPS, whole=True, words=("auto",)),
            "steps",
        ),
        "stats": attribute("show_stats", Flag(), "the statistics page"),
        "help": attribute("show_help", Flag(), "the page of keys"),
        "osd": attribute("osd", Flag(), "whether the screen says what keys change"),
        "message": Property("what the screen says, empty after it has faded", lambda: session.message.text),
        "placing": Property("whether the picture is being placed", lambda: session.placing is not None),
        "fullscreen": Property(
            "whether the monitor is filled", lambda: display.fullscreen, display.set_fullscreen, Flag()
        ),
        "monitor": Property(
            "name of the monitor; a name or number moves the window", lambda: display.monitor, display.move_to
        ),
        "gap": Property("relative gap to the best picture, null if unknown", gap),
        "psnr": Property("dB of the predicted camera picture, null if unknown", psnr),
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
