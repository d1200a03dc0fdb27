"""The commands of a session, for keys, settings and remotes. docs/player.md lists them."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from counterlight.command import tell
from counterlight.files.picture_files import write_png
from counterlight.pipeline.value_types import FLAG, Choice, Number, UnreadError
from counterlight.show.placing import Placing
from counterlight.show.previews import PREVIEWS, Previews
from counterlight.show.properties import TIME, playback_of, properties_of, read_again
from counterlight.show.registry import Command, CommandError, Commands
from counterlight.show.renderers import not_reloaded
from counterlight.show.session import Session
from counterlight.show.stats_page import position
from counterlight.show.watching import Watching, watching_properties
from counterlight.unattended.pjlink import Lamps
from counterlight.writing.replacing import replacing_file

ANY_NUMBER = Number(-1e9, 1e9)
SEEKS = Choice(("relative", "absolute", "absolute-percent"))
LOADS = Choice(("replace", "append", "append-play", "insert-next", "insert-next-play"))


def commands_of(
    session: Session,
    check: Callable[[], object],
    checking: Callable[[], bool],
    lamps: Lamps | None = None,
    watching: Watching | None = None,
) -> Commands:
    """Return every command and property of a session.

    check : begins a check of the room.
    checking : whether a check is running.
    lamps : projectors that can be switched.
    watching : calibration from the running film.
    """
    properties = properties_of(session, checking, lamps) | watching_properties(session, watching)
    return Commands(_commands(session, _Actions(session, lamps), check), properties)


def _commands(session: Session, do: "_Actions", check: Callable[[], object]) -> dict[str, Command]:
    return {
        "seek": Command(
            "move by seconds, or go to a time or a percentage", do.seek, "SECONDS [relative|absolute|absolute-percent]"
        ),
        "frame-step": Command("show the next frame and pause", lambda: do.step(1)),
        "frame-back-step": Command("show the previous frame and pause", lambda: do.step(-1)),
        "playlist-next": Command("play the next medium of the list", lambda: do.playlist(1)),
        "playlist-prev": Command("play the previous medium of the list", lambda: do.playlist(-1)),
        "loadfile": Command(
            "play a medium or a list, or add it at the end or after the current medium; -play: and play at a held end",
            do.load,
            "PATH [replace|append|append-play|insert-next|insert-next-play]",
        ),
        "playlist-remove": Command("remove a medium from the list", do.playlist_remove, "POSITION|current"),
        "playlist-clear": Command("remove all media from the list except the current medium", session.programme.clear),
        "playlist-move": Command("move a medium before another medium", do.playlist_move, "FROM TO"),
        "playlist-shuffle": Command("shuffle the list", session.programme.shuffle),
        "browse": Command(
            "list a folder as an object; without FOLDER, the folders that remotes may name",
            do.browse,
            "[FOLDER]",
        ),
        "ab-loop": Command("set point A, then B, then clear both", do.ab_loop),
        "preview": Command(
            "small picture of the screen, or of what the camera will see; null if SERIAL is still current, or if "
            "there is no time for it",
            do.preview,
            "[screen|camera] [SERIAL]",
        ),
        "screenshot": Command("save the view as a PNG picture; its path is the result", do.screenshot),
        "show-keys": Command("show the next page of keys; after the last page, none", do.keys),
        "show-progress": Command("show the position in the medium over the picture", do.progress),
        "show-text": Command("show a line over the picture", do.show_text, "TEXT [MILLISECONDS]"),
        "identify": Command("show the name of every monitor on it", do.identify),
        "reload": Command("read the maps, the lut and the shaders again; damaged files change nothing", do.reload),
        "place": Command("start to place the picture in the camera's view", do.place),
        "place-move": Command("move the picture or the selected corner, in shares of the view", do.place_move, "DX DY"),
        "place-scale": Command("scale the picture about its middle", do.place_scale, "FACTOR"),
        "place-grab": Command("grab the corner at this point, or the whole picture", do.place_grab, "X Y"),
        "place-drag": Command("drag what was grabbed to this point, in shares of the view", do.place_drag, "X Y"),
        "place-release": Command("release what was grabbed", lambda: do.placing().let_go()),
        "place-corner": Command("select the next corner, or the whole picture", do.place_corner),
        "place-undo": Command("undo the last change", do.place_undo),
        "place-fit": Command("fit the picture into the view, as without a placement", do.place_fit),
        "place-save": Command("save the placement in the calibration folder", do.place_save),
        "place-cancel": Command("discard the changes of the placement", do.place_cancel),
        "check-room": Command("check the room with its camera, and correct what has moved", check),
        "projector": Command(
            "switch projector NUMBER of --schedule, from 0, or all projectors",
            do.projector,
            "on|off [NUMBER]",
        ),
        "quit": Command("end the player", do.quit),
    }


class _Actions:
    """Implements the commands. When a key ran a command, a returned text is also shown on the screen."""

    def __init__(self, session: Session, lamps: Lamps | None) -> None:
        self._session, self._previews, self._lamps = session, Previews(session), lamps

    def seek(self, seconds: object, how: object = "relative") -> str:
        playback = playback_of(self._session)
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
        if not playback_of(self._session).reader.info.still:
            playback_of(self._session).step(direction)

    def playlist(self, by: int) -> str:
        session = self._session
        if not session.programme.go(by):
            raise CommandError("no further medium in the list" if by > 0 else "no medium before this one")
        return (
            f"{session.playlist.position + 1}/{len(session.playlist.media)} {Path(session.playlist.current.name).name}"
        )

    def load(self, path: object, how: object = "replace") -> str:
        word = LOADS.read(how)
        loading = {"replace": word == "replace", "follows": word.startswith("insert"), "play": word.endswith("-play")}
        return Path(self._session.programme.load(str(path), **loading).name).name

    def playlist_remove(self, position: object) -> None:
        session = self._session
        present = session.playlist.position
        index = present if position == "current" else self._position("playlist-remove", position)
        if not session.programme.remove(index) and session.playback is not None:
            session.playback.end()

    def playlist_move(self, position: object, before: object) -> None:
        """Move a medium. As in mpv, `before` may be the last position plus one."""
        first = self._position("playlist-move", position)
        self._session.programme.move(first, self._position("playlist-move", before, more=1))

    def _position(self, name: str, value: object, *, more: int = 0) -> int:
        last = len(self._session.playlist.media) - 1 + more
        try:
            return int(Number(0, last, whole=True).read(value))
        except UnreadError:
            raise CommandError(f"{name}: expected a position from 0 to {last}, found {value!r}") from None

    def browse(self, folder: object = "") -> object:
        return self._session.programme.opener.browse(str(folder))

    def ab_loop(self) -> str:
        playback = playback_of(self._session)
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
            write_png(temporary, session.renderer.encoded())
        tell(f"saved {path}", sys.stdout)
        return str(path)

    def preview(self, name: object = "screen", serial: object = -1) -> dict[str, object] | None:
        return self._previews.take(PREVIEWS.read(name), ANY_NUMBER.read(serial))

    def keys(self) -> None:
        self._session.help_page += 1
        self._session.changed()

    def progress(self) -> None:
        playback_of(self._session)
        self._session.say(position(self._session))

    def show_text(self, text: object, milliseconds: object = 1000) -> None:
        self._session.say(str(text), TIME.read(milliseconds) / 1000)

    def identify(self) -> str:
        self._session.display.identify()
        return f"this is {self._session.display.monitor}"

    def reload(self) -> str:
        """Read the maps, the colour table and the shaders again. After a failure, the show keeps the old ones."""
        session = self._session
        try:
            lut = session.adjustments.lut and read_again(session.adjustments.lut)
            session.replace_renderer(session.room.reload())
            if lut is not None:
                session.adjust(replace(session.adjustments, lut=lut))
        except Exception as error:  # an edited shader can fail in any way
            line = not_reloaded(error)
            session.stats.notice(line)
            raise CommandError(line) from None
        return "maps and shaders reloaded"

    def place(self) -> None:
        session = self._session
        if session.placing is None:
            session.placing = Placing(session.adjustments.corners or self._fitted(), session.adjustments.corners)

    def place_move(self, dx: object, dy: object) -> None:
        placing = self.placing()
        placing.move(ANY_NUMBER.read(dx), ANY_NUMBER.read(dy))
        self._apply(placing)

    def place_scale(self, factor: object) -> None:
        placing = self.placing()
        placing.scale(Number(0.01, 100).read(factor))
        self._apply(placing)

    def place_grab(self, x: object, y: object) -> None:
        self.placing().grab(ANY_NUMBER.read(x), ANY_NUMBER.read(y))
        self._session.changed()

    def place_drag(self, x: object, y: object) -> None:
        placing = self.placing()
        if placing.drag(ANY_NUMBER.read(x), ANY_NUMBER.read(y)):
            self._apply(placing)

    def place_corner(self) -> str:
        placing = self.placing()
        placing.select_next()
        return placing.selected

    def place_undo(self) -> str:
        placing = self.placing()
        if not placing.undo():
            return "nothing to take back"
        self._apply(placing)
        return ""

    def place_fit(self) -> None:
        placing = self.placing()
        placing.put(self._fitted())
        self._apply(placing)

    def place_save(self) -> str:
        session, placing = self._session, self.placing()
        corners = None if placing.corners == self._fitted() else placing.corners
        saved = session.room.keep(corners)
        session.adjust(replace(session.adjustments, corners=corners))
        session.placing = None
        return "placement: as large as fits" if corners is None else f"saved {saved}"

    def place_cancel(self) -> str:
        session, placing = self._session, self.placing()
        session.adjust(replace(session.adjustments, corners=placing.before))
        session.placing = None
        return "placement as it was"

    def projector(self, power: object, number: object = None) -> str:
        lamps = self._lamps
        if lamps is None or not len(lamps):
            raise CommandError("projector: none is named; start with --supervise --schedule FILE")
        on = FLAG.read(power)
        which = None if number is None else int(Number(0, len(lamps) - 1, whole=True).read(number))
        lamps.switch(which, on=on)
        return f"projector{'s' if which is None else f' {which}'} {'on' if on else 'off'}"

    def quit(self) -> None:
        self._session.quit()

    def placing(self) -> Placing:
        if self._session.placing is None:
            raise CommandError("the picture is not being placed; begin with: place")
        return self._session.placing

    def _fitted(self) -> Any:
        return self._session.room.fit(playback_of(self._session).reader.info.format)

    def _apply(self, placing: Placing) -> None:
        self._session.adjust(replace(self._session.adjustments, corners=placing.corners))
