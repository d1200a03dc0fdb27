"""Playback in a window, from loop to loop: keys and remotes, the frame that is due, what is drawn and written over it.

Which frame is due is playback.py's to say, what comes next playlist.py's, what keys and remotes can do
controls.py's. Knows no OpenGL; a display and a clock are handed in.
"""

import gc
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

from player.errors import InputError
from player.frames import Frame, MediaInfo
from player.picture import Picture
from player.refinement import Certificate, StepBudget
from player.renderer import Renderer
from player.show import controls
from player.show.keys import Keys
from player.show.osd import MESSAGE_SIZE, Message, Page
from player.show.outline import Outline, moved, outline_of
from player.show.placing import Placing
from player.show.playback import Playback, Reader, Sound
from player.show.playlist import Playlist
from player.show.session_inputs import Audio, Display, Heartbeat, Remote, Setup, Site, Steps
from player.show.stats_page import facts, stats_page
from player.stats import Stats

CERTIFICATE_INTERVAL_S = 0.5
PAGE_INTERVAL_S = 0.2
LONGEST_WAIT_S = 0.05  # between looks at the decoder and the remotes; keys wake the window at once
FADE_WAIT_S = 0.03
REDRAW = "redraw"  # not a key: the window was resized or uncovered


class Session:
    """Plays a playlist through a renderer into a display.

    open_reader : a medium, and whether the reader shall begin again at its end -> its reader.
    clock : seconds, monotonic.
    """

    def __init__(
        self,
        playlist: Playlist,
        open_reader: Callable[[str, bool], Reader],
        renderer: Renderer,
        display: Display,
        *,
        setup: Setup | None = None,
        site: Site | None = None,
        bindings: Mapping[str, str] | None = None,
        remotes: Sequence[Remote] = (),
        heartbeat: Heartbeat | None = None,
        audio: Audio | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.setup = setup or Setup()
        self.playlist, self.display, self.site, self.audio = playlist, display, site, audio
        self.stats, self.message = Stats(), Message(clock)
        self.view, self.compensation, self.blackout = self.setup.view, self.setup.compensation, self.setup.blackout
        self.picture, self.osd, self.screenshots = self.setup.picture, self.setup.osd, self.setup.screenshots
        self.show_stats = self.show_help = self.done = False
        self.placing: Placing | None = None
        self.image_display_duration = self.setup.image_display_duration
        self.refine: Steps = self.setup.refine
        self._silence = self.setup.silence
        self.renderer = renderer
        self._incoming: Renderer | None = None
        self._open_reader, self._clock = open_reader, clock
        self._remotes, self._heartbeat = remotes, heartbeat
        self._failures = self._draws = self._steps_made = 0
        self.rendered_view = self.view
        self._changed = self._uploaded = False
        self._shown: tuple[Page | None, bool] = (None, False)
        self._paged_at = self._certified_at = float("-inf")
        self._certificate: Certificate | None = None
        self._outlined: tuple[object, Outline] | None = None
        self.playback: Playback | None = None
        self.open_current(first=True)
        self.commands = controls.commands_of(self)
        self.keys = Keys(self.commands, bindings)

    def run(self, limit: int | None = None) -> Stats:
        """Play until the list ends, the window closes, `q`, or `limit` frames have been shown."""
        try:
            with short_collections():
                self._run(limit)
            if self._draws:
                certificate = self.certificate(max_age_s=0.0)
                certified = {} if certificate is None else certificate.to_dict()
                self.stats.facts["gpu_path"] = self.renderer.path.to_dict()
                self.stats.facts["refinement"] = {"steps": round(self._steps_made / self._draws, 1), **certified}
            return self.stats
        finally:
            self.close()

    def _run(self, limit: int | None) -> None:
        while not (self.done or self.display.closed):
            for key in self.display.poll(self._wait_s()):
                self.press(key)
            for remote in self._remotes:
                remote.poll(self.commands)
            self.step()
            if self._heartbeat is not None and self._heartbeat.due and self.playback is not None:
                self._heartbeat.beat(facts(self))
            if limit is not None and self.stats.frames >= limit:
                return

    def close(self) -> None:
        """End the decoder. The renderer belongs to whoever made it, except one that reload brought."""
        if self.playback is not None:
            self.playback.close()
            self._collect_notices()
        if self._incoming is not None:
            self._incoming.release()
            self._incoming = None

    def step(self) -> None:
        """Take the frame that is due, if any, and show it; draw again what a key or a remote changed."""
        self._collect_notices()
        playback = self.playback
        if playback is None or self.done:
            return
        try:
            frame = playback.due()
        except InputError as error:
            self._pass_over(error)
            self.open_current()
            return
        self.stats.dropped, playback.dropped = self.stats.dropped + playback.dropped, 0
        self.stats.stalled_s, playback.stalled_s = self.stats.stalled_s + playback.stalled_s, 0.0
        if frame is not None:
            self._upload(frame, playback)
        elif playback.finished:
            self.go(1)
            return
        self._draw(playback, frame)

    def press(self, key: str) -> None:
        """Do what a key stands for and say on the screen what it changed; unknown keys do nothing."""
        if key == REDRAW:
            self._changed = True
            return
        said = self.keys.press(key, placing=self.placing is not None)
        if said:
            self.say(said)

    def say(self, text: str, seconds: float | None = None) -> None:
        """Write a line over the picture for a while."""
        self.message.say(text, *([] if seconds is None else [seconds]))

    def notice(self, text: str) -> None:
        """Something that went wrong without stopping the show: for the log, the statistics and the screen."""
        print(text, file=sys.stderr)
        self.stats.notices.append(text)
        self.say(text, 3.0)

    def changed(self) -> None:
        """Have the view drawn again."""
        self._changed = True

    def adjust(self, picture: Picture) -> None:
        self.renderer.adjust(picture)
        if self._incoming is not None:
            self._incoming.adjust(picture)
        self.picture = picture
        self._changed = True

    def set_refine(self, steps: Steps) -> None:
        self.refine = steps
        self._budget = self._new_budget()
        self._changed = True

    @property
    def steps(self) -> int:
        """Of refinement, a frame."""
        return self._budget.steps if self._budget is not None else int(self.refine)

    def go(self, by: int) -> bool:
        """Play the next (1) or the one before (-1); past the end the session is done, before the beginning it stays."""
        if self.playlist.step(by):
            self.open_current()
            return True
        self.done = self.done or by > 0
        return False

    def open_current(self, *, first: bool = False) -> None:
        """Open the playlist's medium; those that cannot be opened are told and passed over."""
        while not self.done:
            try:
                self.begin(self.playlist.current, self.setup.start_s if first else 0.0)
                return
            except InputError as error:
                self._pass_over(error)

    def begin(self, medium: str, start_s: float = 0.0) -> None:
        """Play a medium; raises InputError, leaving what plays, if it cannot be opened."""
        before = self.playback
        loop = self.setup.loop_file if before is None else before.loop
        reader = self._open_reader(medium, loop)
        try:
            self.renderer.open(reader.info.format)
            self.renderer.adjust(self.picture)
        except BaseException:
            reader.close()
            raise
        self.playback = Playback(
            reader,
            self._clock,
            loop=loop,
            seamless=loop,
            hold_s=self.image_display_duration,
            paused=before is not None and before.paused,
            speed=self.setup.speed if before is None else before.speed,
            sound=self._sound(reader.info, medium),
        )
        if before is not None:
            before.close()
            for text in before.reader.notices():
                self.notice(text)
        if start_s and not reader.info.still:
            self.playback.seek(start_s)
        if self._incoming is not None:
            self._incoming.open(reader.info.format)
        self._uploaded, self.placing = False, None
        self._budget = self._new_budget()
        self.stats.interrupted()
        self.display.set_title(f"{medium} - Counterlight")

    def replace_renderer(self, renderer: Renderer) -> None:
        """Take another renderer as soon as it has a frame to show; what is on the screen stays until then."""
        assert self.playback is not None
        try:
            renderer.open(self.playback.reader.info.format)
            renderer.adjust(self.picture)
        except BaseException:
            renderer.release()
            raise
        if self._incoming is not None:
            self._incoming.release()
        self._incoming = renderer
        self.playback.refresh()

    @staticmethod
    def not_reloaded(error: Exception) -> str:
        """A line that says why what was there stays."""
        known = isinstance(error, InputError | OSError | RuntimeError)
        return f"not reloaded: {' '.join((str(error) if known else repr(error)).split())}"

    def certificate(self, max_age_s: float = CERTIFICATE_INTERVAL_S) -> Certificate | None:
        """How far the picture is from the best one; measured again if what is known is older."""
        if self._uploaded and self._draws and self._clock() - self._certified_at >= max_age_s:
            self._certificate, self._certified_at = self.renderer.certificate(), self._clock()
        return self._certificate

    @property
    def rendered(self) -> bool:
        """Whether there is a view to save."""
        return self._draws > 0

    def _upload(self, frame: Frame, playback: Playback) -> None:
        start = time.perf_counter()
        if self._incoming is None or not self._took_over(self._incoming, frame):
            self.renderer.upload(frame)
        playback.reader.release(frame)
        self.stats.add("decode", frame.decode_s)
        self.stats.add("upload", time.perf_counter() - start)
        self.stats.frames += 1
        self._failures = 0
        self._uploaded = self._changed = True

    def _took_over(self, incoming: Renderer, frame: Frame) -> bool:
        """Whether what reload brought can draw a frame: it then takes the place of the renderer, which else stays."""
        self._incoming = None
        try:
            incoming.upload(frame)
            incoming.render(self.view, compensate=self.compensation, frame=self.stats.frames, steps=self.steps)
        except Exception as error:  # an edited shader can go wrong in any way
            incoming.release()
            self.notice(self.not_reloaded(error))
            return False
        self.renderer.release()
        self.renderer = incoming
        return True

    def _draw(self, playback: Playback, frame: Frame | None) -> None:
        """Render if the view has changed, and present if that or the page over it has."""
        render = self._changed and self._uploaded
        if render:
            self._render()
        shown = self._new_page(), self.blackout
        if self._draws and (render or shown != self._shown):
            start = time.perf_counter()
            self.display.present(shown[0], black=self.blackout)
            self.stats.add("present", time.perf_counter() - start)
            self._shown = shown
            due_s = playback.due_at(frame) if frame is not None else None
            if due_s is not None:
                self.stats.shown(self._clock(), due_s)
            elif frame is not None:
                self.stats.interrupted()

    def _render(self) -> None:
        start, steps = time.perf_counter(), self.steps
        self.renderer.render(self.view, compensate=self.compensation, frame=self.stats.frames, steps=steps)
        self.renderer.finish()
        seconds = time.perf_counter() - start
        self.stats.add("gpu", seconds)
        if self._budget is not None:
            self._budget.took(seconds)
        self._draws += 1
        self.rendered_view = self.view
        self._steps_made += steps
        self._changed = False

    def _sound(self, info: MediaInfo, medium: str) -> Sound | None:
        """The sound of a medium that has one; why it is not heard is told once."""
        if not info.sound or info.still or info.live:
            return None
        if self.audio is not None:
            return self.audio.open(medium)
        if self._silence is not None:
            self.notice(self._silence)
            self._silence = None
        return None

    def _new_page(self) -> Page | None:
        """What is written and drawn over the picture."""
        page, outline = self._text(), self._outline()
        return page if outline is None else replace(page or Page(()), outline=outline)

    def _outline(self) -> Outline | None:
        """Of the picture that is being placed; made anew when the corners, the view or the room have changed."""
        placing = self.placing
        if placing is None or self.site is None:
            return None
        key = placing.corners, placing.corner, self.view == "projector", self.renderer
        if self._outlined is None or self._outlined[0] != key:
            outline = outline_of(placing.corners, placing.corner, self.site.camera())
            self._outlined = key, moved(outline, self.site.on_projector) if self.view == "projector" else outline
        return self._outlined[1]

    def _text(self) -> Page | None:
        """What is written over the picture; the statistics' figures stand still for PAGE_INTERVAL_S."""
        text, opacity = self.message.text, self.message.opacity
        if self.show_help:
            return Page(tuple(self.keys.help_lines(placing=self.placing is not None)))
        if self.show_stats:
            shown = self._shown[0]
            if shown is not None and shown.histogram and self._clock() - self._paged_at < PAGE_INTERVAL_S:
                return shown
            self._paged_at = self._clock()
            return stats_page(self, text)
        if self.placing is not None:
            return Page((f"placing the {self.placing.selected}; ? lists the keys", *([text] if text else [])))
        return Page((text,), opacity=opacity, size=MESSAGE_SIZE) if text and self.osd else None

    def _wait_s(self) -> float:
        if self._changed and self._uploaded:
            return 0.0
        wait = LONGEST_WAIT_S if self.playback is None else self.playback.wait_s(LONGEST_WAIT_S)
        return min(wait, FADE_WAIT_S) if self.message.opacity else wait

    def _pass_over(self, error: InputError) -> None:
        """Go on to the next medium, or raise if none of the list can be played."""
        self._failures += 1
        if self._failures >= len(self.playlist.media):
            raise error
        self.notice(str(error))
        self.done = not self.playlist.step(1)

    def _collect_notices(self) -> None:
        readers = [] if self.playback is None else self.playback.reader.notices()
        for text in [*readers, *self.display.notices()]:
            self.notice(text)

    def _new_budget(self) -> StepBudget | None:
        if self.refine != "auto" or self.playback is None:
            return None
        return StepBudget(1 / self.playback.reader.info.frames_per_second)


@contextmanager
def short_collections() -> Iterator[None]:
    """Keep what is alive now out of garbage collections, which then take a fraction of a frame's time."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
