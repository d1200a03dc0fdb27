"""Takes each frame from the film to the screen: uploads, renders, presents and counts the frame that is due.

`Session.step` comes first, followed by the methods that it calls, in the order of the calls. The methods that change
the medium, and the properties that keys and remotes control, come last. playback.py decides which frame is due,
programme.py which medium is next. This module knows no OpenGL; the display and the clock are arguments.
"""

import time
from collections.abc import Callable
from pathlib import Path

from counterlight.command import tell
from counterlight.errors import DrawingError, InputError, printable
from counterlight.media.frames import Frame, PixelFormat
from counterlight.media.medium import Medium
from counterlight.overlay.osd import Message, Page
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.show.appraisal import INTERVAL_S, Appraisal
from counterlight.show.beginning import NO_SOUND, PLAYING, SHOWING, Playing, Showing, Sound
from counterlight.show.display import Display
from counterlight.show.fading import FADE_WAIT_S, Fade, Leaving
from counterlight.show.governor import Governor, draw
from counterlight.show.hearing import Hearing
from counterlight.show.lateness import Lateness
from counterlight.show.media import Media
from counterlight.show.pacing import Pace
from counterlight.show.placing import Placing
from counterlight.show.playback import Manner, Playback
from counterlight.show.playlist import Playlist
from counterlight.show.programme import Opening, Programme
from counterlight.show.renderers import Renderers
from counterlight.show.room_in_use import RoomInUse
from counterlight.show.stats import Stats

TIMED_INTERVAL_S = 0.5  # shortest time between frames whose stages are timed
MOST_REDRAWS = 12  # redraws of a picture that stays on the screen until its steps suffice
LONGEST_WAIT_S = 0.05  # longest wait before the decoder and the remotes are polled; keys wake the window at once
AHEAD_S = 10.0  # the next medium is opened this long before a medium ends; a decoder starts in 0.3 s
OPENING_WAIT_S = 0.01  # longest wait while a medium is being opened


class Session:
    """Plays a playlist through a renderer into a display.

    opener : finds and opens media.
    room : the room that the session plays in.
    governor : chooses the steps of each frame; None for no steps.
    appraised : whether the distance from the optimum is estimated for every picture. Otherwise it is estimated on
        request, or if the user has set a limit (`within`).
    lasting : whether the show continues even if its media fail.
    unattended : whether the show runs without an operator. Notices then appear over the picture only if `osd` allows
        them.
    screenshots : folder of screenshots.
    clock : seconds, monotonic.
    """

    def __init__(
        self,
        playlist: Playlist,
        opener: Media,
        renderer: AnyRenderer,
        display: Display,
        room: RoomInUse,
        *,
        governor: Governor | None = None,
        playing: Playing = PLAYING,
        showing: Showing = SHOWING,
        sound: Sound = NO_SOUND,
        appraised: bool = False,
        lasting: bool = False,
        unattended: bool = False,
        screenshots: Path = Path(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.playlist, self.display, self.room, self.clock = playlist, display, room, clock
        self.view, self.compensation, self.blackout = showing.view, showing.compensation, showing.blackout
        self.adjustments, self.osd, self.screenshots = showing.adjustments, showing.osd, screenshots
        self.governor = governor or Governor(0)
        self.governor.notice = self.notice
        self.appraisal, self._appraised = Appraisal(room.appraise, clock), appraised
        self.stats, self.message = Stats(), Message(clock)
        self.show_stats = self.done = False
        self.help_page = 0  # number of the shown help page, from 1; 0 for none
        self.placing: Placing | None = None
        self._outside = room.stand(self.adjustments.viewpoint)
        self.audio, self._hearing = sound.output, Hearing(sound.output, sound.silence, self.notice)
        self._lasting, self._unattended = lasting, unattended
        self.renderers = Renderers(renderer, self.notice)
        self._draws = self._steps_made = 0
        self.rendered_view, self._steps_drawn, self._redraws = self.view, 0, 0
        self._changed = self._uploaded = self._uncovered = False
        self._shown: tuple[Page | None, bool] | None = None
        # clock times of the last timed frame and of the last upload
        self._timed_at, self._taken_at = float("-inf"), 0.0
        self.playback: Playback | None = None
        self._manner = Manner(playing.loop_file, playing.speed)
        self._start: tuple[Medium, float] | None = playlist.current, playing.start_s
        self._lateness: Lateness | None = None
        self._prepared: Opening | None = None  # the next medium
        self.image_display_duration, self.keep_open = playing.image_display_duration, playing.keep_open
        self.fade, self.crossfade_s = Fade(playing.fade_s, clock), playing.crossfade_s
        self._leaving: Leaving | None = None
        self._faded = 1.0, 0.0  # last render: share of the light, weight of the leaving medium
        self._quitting = False
        self._undrawn: str | None = None  # why the last frame could not be drawn
        # called with the page and whether the screen is black
        self.on_present: Callable[[Page | None, bool], None] | None = None
        self._follows_s: float | None = None  # when the next medium's first frame is due on the screen
        self.programme = Programme(
            playlist,
            opener,
            lasting=lambda: self._lasting or self.playlist.loop or self.manner.loop,
            begins_again=lambda: self.playlist.loop or self.manner.loop,
            keep=self._keep,
            looping=lambda: self.manner.loop,
            notice=self.notice,
            clock=clock,
        )

    def outcome(self) -> Stats:
        """Return the counts. Raises InputError if a medium that could not be played ended the show."""
        if self.programme.failure is not None:
            raise self.programme.failure
        if self.room.drifted is not None:
            self.stats.facts["drift"] = self.room.drifted
        if self._draws:
            self.certificate(max_age_s=0.0)
            if self._appraised and self._uploaded:
                self.appraisal.conclude(self.renderer)
            self.stats.facts["gpu_path"] = self.renderer.path.to_dict()
            steps = round(self._steps_made / self._draws, 1)
            self.stats.facts["refinement"] = {"steps": steps, **self.appraisal.to_dict()}
        return self.stats

    def close(self) -> None:
        """End the decoders, and release the renderer, which belongs to the session."""
        self.programme.close()
        self._hearing.close()
        self._end_crossfade()
        if self.playback is not None:
            self.playback.close()
            self._collect_notices()
        self.renderers.release()

    def step(self, page: Callable[[], Page | None]) -> None:
        """Show the frame that is due, if any. Draw the picture again if a key or a remote has changed it.

        page : returns the page over the picture; called after rendering.
        """
        self._collect_notices()
        frame = self._due()
        # the medium may have ended just now; the next medium's first frame is then due at once
        if frame is None and self.programme.over:
            frame = self._due()
        self.done = self.done or self.programme.done
        if not self.done:
            self._draw(frame, page)
            self._appraise()
            self._look_ahead()

    def _collect_notices(self) -> None:
        readers = [] if self.playback is None else self.playback.reader.notices()
        for text in [*readers, *self.display.notices()]:
            self.notice(text)

    def _due(self) -> Frame | None:
        """Return the frame that is due, uploaded. Report the medium's end and its errors to the programme."""
        opening = self.programme.poll()
        if opening is not None:
            self._change_to(opening)
        playback = self.playback
        if playback is not None and self.programme.at_end and not playback.finished:
            self.programme.resume()
        if playback is None or self.programme.over:
            return None
        try:
            frame = playback.due()
            if playback.dropped:
                self.stats.drop(playback.dropped, self.clock())
                playback.dropped = 0
            self.stats.stalled_s, playback.stalled_s = self.stats.stalled_s + playback.stalled_s, 0.0
            if frame is not None:
                self._upload(frame, playback)
            elif playback.finished or self._fades_over(playback):
                self.programme.ended()
                if self.programme.at_end:
                    playback.paused = True
            return frame
        except InputError as error:
            self.programme.broke(error)
            return None

    def _upload(self, frame: Frame, playback: Playback) -> None:
        start, self._taken_at = time.perf_counter(), self.clock()
        try:
            if not self.renderers.are_open_for(frame.format):  # a live source has changed its format
                self._open_renderers(frame.format)
            if not self._took_over(frame):
                self.renderer.upload(frame)
        finally:
            playback.reader.release(frame)
        self.stats.add("decode", frame.decode_s)
        self.stats.add("upload", time.perf_counter() - start)
        self.stats.frames += 1
        self._uploaded, self._changed, self._redraws = True, True, 0
        advice = (
            None
            if self._lateness is None
            else self._lateness.advice(self.clock(), self.steps, self.every, adapts=self.governor.adapts)
        )
        if advice is not None:
            self.notice(advice)

    def _took_over(self, frame: Frame) -> bool:
        """Whether a reloaded renderer has drawn the frame and has thereby replaced the old renderer."""

        def drawn(renderer: AnyRenderer) -> None:
            renderer.upload(frame)
            renderer.render(self.view, compensate=self.compensation, frame=self.stats.frames, steps=self.steps)

        if not self.renderers.took_over(drawn):
            return False
        self._end_crossfade()
        self.appraisal.forget()
        return True

    def _draw(self, frame: Frame | None, page: Callable[[], Page | None]) -> None:
        """Render a changed view, and present a changed view or page. The display is black before the first frame."""
        self._play_leaving()
        level = self.fade.towards(0.0 if self._dark() else 1.0) if self._draws or not self.fade.seconds else 0.0
        self.done = self.done or (self._quitting and level == 0)
        faded = level or 1.0, 0.0 if self._leaving is None else self._leaving.weight
        render = (self._changed or faded != self._faded) and self._uploaded
        if render:
            self._faded = faded
            self.renderer.fade(*faded)
            self._render()
        drawn_s = self.clock() - self._taken_at
        shown = page(), level == 0 or not self._draws
        if render or self._uncovered or shown != self._shown:
            start = time.perf_counter()
            self.display.present(shown[0], black=shown[1])
            self.stats.add("present", time.perf_counter() - start)
            self._shown, self._uncovered = shown, False
            if self.on_present is not None:
                self.on_present(*shown)
        if frame is None or self.playback is None:
            return
        follows_s, self._follows_s = self._follows_s, None
        due_s = self.playback.due_at(frame) if follows_s is None else follows_s
        if due_s is not None:
            self.stats.shown(self.clock(), due_s, frame.duration_s / self.playback.speed)
            self._keep_pace(frame, self.playback, drawn_s)
        else:
            self.stats.interrupted()

    def _play_leaving(self) -> None:
        """Draw the next frame of the medium that fades out, and close the medium when its weight is 0."""
        leaving = self._leaving
        if leaving is None:
            return
        try:
            self._changed |= leaving.upload_into(self.renderer)
        except InputError as error:
            self.notice(str(error))
            self._end_crossfade()
        if leaving.weight == 0:
            self._end_crossfade()

    def _dark(self) -> bool:
        """Whether the picture should be black or fade to black."""
        keep, playback = self._keep(), self.playback
        if self.blackout or self._quitting or (self.programme.at_end and keep == "black"):
            return True
        ends = playback is not None and not self.programme.over and self.programme.is_last and keep in ("no", "black")
        return ends and playback is not None and self.fade.seconds > 0 and playback.ends_within(self.fade.seconds)

    def _render(self) -> None:
        timed = self._settles or self.clock() - self._timed_at >= TIMED_INTERVAL_S
        self._changed = False
        try:
            steps = draw(
                self.renderer,
                self.governor,
                self.stats,
                self.view,
                compensate=self.compensation,
                frame=self.stats.frames,
                timed=timed,
            )
        except DrawingError as error:  # an edited shader that is drawn for the first time; the last picture stays
            if not self._draws:
                raise
            if self._undrawn != str(error):
                self._undrawn = str(error)
                self.notice(f"not drawn: {error}")
            return
        self._undrawn = None
        if timed:
            self._timed_at = self.clock()
        self._draws += 1
        self.rendered_view, self._steps_drawn = self.view, steps
        self._steps_made += steps

    def _keep_pace(self, frame: Frame, playback: Playback, drawn_s: float) -> None:
        """Show only every n-th frame if even the fewest steps take too long. Lower n once there is time again."""
        pace = playback.pace
        if pace is None:
            return
        if pace.shown(frame.time_s, self.clock(), drawn_s, may_slow=self.governor.is_at_least):
            self.governor.slow_to(pace.shown_s)

    def _appraise(self) -> None:
        """Estimate the distance from the optimum if needed. Redraw a still picture if other steps improve it."""
        wanted = self._appraised or self.appraisal.asked or self.show_stats or self.governor.within != "no"
        try:
            if wanted and self._draws and self._uploaded:
                self.appraisal.look(self.renderer)
            self.appraisal.poll(self.governor)
        except InputError as error:
            self.notice(str(error))
        if self._settles and self._steps_drawn != self.steps:
            self._redraws += 1
            self._changed = True

    @property
    def _settles(self) -> bool:
        """Whether the picture stays on the screen and may need another number of steps."""
        stays = self.playback is not None and (self.playback.reader.info.still or self.playback.paused)
        return stays and self.governor.governs and self._draws > 0 and self._redraws < MOST_REDRAWS

    def wait_s(self) -> float:
        """Return the seconds until something is due, unless a command comes first."""
        if self._changed and self._uploaded:
            return 0.0
        wait = LONGEST_WAIT_S if self.playback is None else self.playback.wait_s(LONGEST_WAIT_S)
        wait = min(wait, OPENING_WAIT_S) if self.programme.is_opening else wait
        fades = self.message.opacity or self._leaving is not None or self.fade.level != (not self._dark())
        return min(wait, FADE_WAIT_S) if fades else wait

    def _change_to(self, opening: Opening) -> None:
        """Play an opened medium. The previous picture stays on the screen until the medium's first frame is due."""
        medium, reader, loop = opening
        before, manner = self.playback, self.manner
        rate = None if reader.info.still else reader.info.frames_per_second
        follows_s = before.ended_at_s if before is not None and self.programme.over else None
        fades = self.crossfade_s > 0 and before is not None and self._uploaded and not self.programme.at_end
        try:
            self._open_renderers(reader.info.format, crossfade=fades)
        except InputError as error:
            reader.close()
            self.programme.refused(error)
            return
        self.playback = Playback(
            reader,
            self.clock,
            loop=manner.loop,
            seamless=loop,
            hold_s=self.image_display_duration,
            paused=manner.paused,
            speed=manner.speed,
            sound=self._hearing.track(reader.info, medium),
            begins_s=follows_s,
            pace=None if rate is None else Pace(1 / rate, self._every(rate)),
        )
        self._follows_s = follows_s
        if before is not None and fades:
            self._leaving = Leaving(before, self.crossfade_s, self.clock)
        elif before is not None:
            self._left(before)
        if self._start is not None:
            start_s = self._start[1] if self._start[0] == medium and not reader.info.still else 0.0
            if start_s:
                self.playback.seek(start_s)
            self._start = None
            if unlit := self.room.unlit(reader.info.format, self.adjustments.corners):
                tell(unlit)
        self.programme.plays()
        if self.placing is not None and self.adjustments.corners is None:
            self.placing.refit(self.room.fit(reader.info.format))
        pace = self.playback.pace
        self.governor.begin(None if pace is None else pace.shown_s)
        self.appraisal.forget()
        self._lateness = None if rate is None else Lateness(self.stats, rate, self.clock())
        self.stats.interrupted()
        if follows_s is not None:
            self.stats.changed()
        self.display.set_title(printable(f"{Path(medium.name).name} - Counterlight"))

    def _open_renderers(self, pixels: PixelFormat, *, crossfade: bool = False) -> None:
        self._end_crossfade()
        self._uploaded = False
        self.renderers.open(pixels, self.adjustments, crossfade=crossfade)

    def _every(self, rate: float) -> int:
        """Return n for a new medium: showing every n-th frame keeps about the present frame rate."""
        pace = None if self.playback is None else self.playback.pace
        return 1 if pace is None else max(round(pace.shown_s * rate), 1)

    def _look_ahead(self) -> None:
        """Prepare the next medium's passes and sound AHEAD_S before the present medium ends."""
        if self.playback is None or self.programme.over or not self._ends_within(AHEAD_S):
            return
        opening = self.programme.look_ahead()
        if opening is not None and opening != self._prepared:
            self._prepared = opening
            info = opening.reader.info
            self.renderers.prepare(info.format, crossfade=self.crossfade_s > 0)
            self._hearing.prepare(info, opening.medium)

    def _ends_within(self, seconds: float) -> bool:
        return self.playback is not None and self.playback.ends_within(seconds, unknown=True)

    def _fades_over(self, playback: Playback) -> bool:
        """Whether the next medium should begin to fade in."""
        soon = self.crossfade_s > 0 and self._leaving is None and self._keep() != "always"
        return soon and playback.ends_within(self.crossfade_s) and self.programme.next_waits

    def _keep(self) -> str:
        """Return what stays on the screen after the end: "no", "yes", "always" or "black"."""
        usual = "black" if self.display.fullscreen else "no"
        return usual if self.keep_open == "auto" else self.keep_open

    def _end_crossfade(self) -> None:
        leaving, self._leaving = self._leaving, None
        if leaving is not None:
            self.renderer.end_crossfade()
            self._left(leaving.playback)

    def _left(self, playback: Playback) -> None:
        """Close a medium that no longer plays, and report its notices."""
        playback.close()
        for text in playback.reader.notices():
            self.notice(text)

    def quit(self) -> None:
        """End the show after a fade to black. A second call ends it at once."""
        self._quitting = not self._quitting and self._draws > 0 and self.fade.seconds > 0 and self.fade.level > 0
        self.done = not self._quitting

    def notice(self, text: str) -> None:
        """Report an error that did not stop the show to the log, the statistics and the operator.

        In front of an audience, no notice is shown unless `osd` allows this.
        """
        text = printable(text)
        tell(text)
        self.stats.notice(text)
        if self.osd == "notices" or not (self._unattended or self.display.fullscreen):
            self.say(text, 3.0)

    def say(self, text: str, seconds: float | None = None) -> None:
        """Write a line over the picture for a while."""
        self.message.say(text, *([] if seconds is None else [seconds]))

    @property
    def writes(self) -> bool:
        """Whether messages and legends are written over the picture."""
        return not self.display.fullscreen if self.osd == "auto" else self.osd != "off"

    def changed(self) -> None:
        """Draw the view again at the next opportunity."""
        self._changed = True

    def uncovered(self) -> None:
        """Present the picture again, because the window was resized or uncovered."""
        self._uncovered = True

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply the viewer's settings. Report a viewpoint outside all views once."""
        self.renderers.adjust(adjustments)
        self.adjustments = adjustments
        outside, before = self.room.stand(adjustments.viewpoint), self._outside
        self._outside = outside
        if outside is not None and before is None:  # warns once, until the viewer is inside again
            self.notice(outside)
        self._changed = True

    def replace_renderer(self, renderer: AnyRenderer) -> None:
        """Switch to another renderer once it has a frame to show. The picture on the screen stays until then."""
        self.renderers.replace(renderer, self.adjustments)
        if self.playback is not None:
            self.playback.refresh()

    @property
    def renderer(self) -> AnyRenderer:
        """The renderer that draws frames."""
        return self.renderers.current

    def certificate(self, max_age_s: float = INTERVAL_S) -> Certificate | None:
        """Return the bound on the distance from the best picture. Measures it again if it is older than `max_age_s`."""
        if self._uploaded and self._draws:
            self.appraisal.certify(self.renderer, max_age_s)
        return self.appraisal.certificate

    @property
    def steps(self) -> int:
        """Steps of refinement for the next frame."""
        return self.governor.steps

    @property
    def steps_made(self) -> int:
        """Steps of refinement in the picture on the screen; 0 without compensation."""
        made = self.compensation and self.adjustments.card is None and self._draws > 0
        return self._steps_drawn if made else 0

    @property
    def rendered(self) -> int:
        """Number of views rendered so far. 0 means that there is no view to save; a new number means a new view."""
        return self._draws

    @property
    def rates(self) -> tuple[float, float]:
        """Frames per second of the medium and on the screen. Both are 0 during a pause and for a still."""
        playback = self.playback
        if playback is None or playback.paused or playback.reader.info.still:
            return 0.0, 0.0
        return playback.reader.info.frames_per_second * playback.speed, self.stats.frames_per_second

    @property
    def every(self) -> int:
        """n if every n-th frame is shown; 1 for all frames."""
        pace = None if self.playback is None else self.playback.pace
        return 1 if pace is None else pace.every

    @property
    def manner(self) -> Playback | Manner:
        """Settings that last across media: loop, pause and speed."""
        return self.playback or self._manner

    @property
    def position_s(self) -> float:
        """Time within the medium. Before the first medium plays, the time where it will start."""
        if self.playback is not None:
            return self.playback.position_s
        return 0.0 if self._start is None else self._start[1]
