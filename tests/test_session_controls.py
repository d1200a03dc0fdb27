"""Effects of keys, commands and remotes on a session with stand-ins (tests/stage.py)."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.overlay.osd import Pointer
from counterlight.show.registry import CommandError, Commands
from tests.stage import SQUARE, Reader, Screen, Stage


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_keys_change_what_is_shown_and_say_so(stage: Stage) -> None:
    stage.advance(0.05)
    stage.press("space")
    expected = {
        "c": (("projector", False, False), "Compensation: off"),
        "b": (("projector", False, True), "Blackout: on"),
        "v": (("camera", False, True), "View: camera"),
    }
    for key, (shown, said) in expected.items():
        assert stage.press(key) == said
        assert stage.screen.shown[-1] == shown
        page = stage.screen.pages[-1]
        assert page is not None
        assert page.lines == (said,)
    before = list(stage.screen.shown)
    stage.press("unknown")
    assert stage.screen.shown == before
    stage.press("f")
    assert stage.screen.fullscreen
    stage.press("escape")
    assert not stage.screen.fullscreen
    assert stage.press("g") == "this is A"
    assert stage.screen.identified == 1
    stage.press("q")
    assert stage.session.done


def test_what_a_key_changed_fades_after_a_second(stage: Stage) -> None:
    stage.advance(0.05)
    stage.press("space")
    stage.advance(2.0)
    stage.screen.pages.clear()
    renders = len(stage.screen.steps)
    stage.press("c")
    stage.advance(0.9)
    assert [page.opacity for page in stage.screen.pages if page] == [1.0]
    stage.advance(1.0)
    opacities = [page.opacity for page in stage.screen.pages if page]
    assert opacities == sorted(opacities, reverse=True)
    assert len(set(opacities)) > 8
    assert stage.screen.pages[-1] is None
    assert len(stage.screen.steps) == renders + 1  # the text fades over the same picture
    assert stage.session.wait_s() > 0.03


def test_without_osd_nothing_is_written(stage: Stage) -> None:
    stage.advance(0.05)
    stage.commands.set("osd", "off")
    stage.press("c")
    assert stage.screen.pages[-1] is None
    stage.press("?")
    assert stage.screen.pages[-1] is not None  # a requested page stays


def test_picture_controls_reach_the_renderer(stage: Stage) -> None:
    stage.advance(0.05)
    assert stage.press("2", "2", "1") == "Contrast: 1"
    stage.press("3", "6", "8", "x")
    stage.commands.set("black-level", 0.25)
    stage.commands.set("adapt", "2.5")
    stage.commands.set("flicker", 0.5)
    stage.press("t")
    picture = stage.screen.adjusted[-1]
    assert (picture.contrast, picture.brightness, picture.gamma, picture.saturation) == (1, -1, 1, 1)
    assert (picture.black_level, picture.adapt, picture.flicker, picture.clipping) == (0.25, 2.5, 0.5, True)
    assert picture.card is not None
    assert stage.commands.get("test-card") == picture.card
    stage.commands.set("test-card", "no")
    assert stage.screen.adjusted[-1].card is None
    before = stage.screen.adjusted[-1]
    for name, value in (("contrast", 101), ("flicker", 1), ("corners", "left"), ("test-card", "x")):
        with pytest.raises(CommandError, match=name):
            stage.commands.set(name, value)
    assert stage.screen.adjusted[-1] is before


def test_sound_is_said_to_be_missing_or_is_set() -> None:
    mute = Stage()
    for key in ("9", "0", "m"):
        assert mute.press(key) == "no audio"
    with pytest.raises(CommandError, match="no audio"):
        mute.commands.get("volume")
    audio: Any = SimpleNamespace(volume=50, mute=False)
    loud = Stage(audio=audio)
    loud.press("0", "m")
    assert (audio.volume, audio.mute) == (52, True)


def test_placing_moves_scales_undoes_and_is_saved(stage: Stage) -> None:
    stage.advance(0.05)

    def corners() -> np.ndarray:
        return np.array(stage.screen.adjusted[-1].corners)

    shifted = np.array(SQUARE) + np.array((0.01, 0.001))
    stage.press("k", "right", "shift+down")
    np.testing.assert_allclose(corners(), shifted)
    stage.press("+")
    np.testing.assert_allclose(np.ptp(corners(), axis=0), 1.02)
    np.testing.assert_allclose(corners().mean(axis=0), (0.51, 0.501))
    stage.press("u")
    np.testing.assert_allclose(corners(), shifted)
    assert stage.press("tab", "tab") == "upper right corner"
    stage.press("up", "enter")
    moved = shifted.copy()
    moved[1, 1] -= 0.01
    np.testing.assert_allclose(stage.saved[-1], moved)
    assert stage.session.placing is None
    stage.press("right")  # another seek
    np.testing.assert_allclose(corners(), moved)
    stage.press("k", "left", "escape")
    np.testing.assert_allclose(corners(), moved)
    assert len(stage.saved) == 1
    stage.press("k", "backspace", "k")
    assert stage.saved[-1] is None
    assert stage.screen.adjusted[-1].corners is None
    assert stage.press("k", "u") == "nothing to take back"
    with pytest.raises(CommandError, match="corners"):
        stage.commands.run("place-move", 9, 0)
    assert stage.screen.adjusted[-1].corners is None


def test_the_placement_survives_a_change_of_media() -> None:
    stage = Stage(Reader("clip"), Reader("wide"), loop_list=True)
    letterbox = tuple((x, 0.25 + 0.5 * y) for x, y in SQUARE)
    stage.fitted["wide"] = letterbox
    stage.advance(0.05)
    stage.press("k")
    stage.commands.run("place-grab", 0.5, 0.5)
    stage.commands.run("playlist-next")
    stage.advance(0.05)
    assert stage.session.placing is not None
    np.testing.assert_allclose(stage.session.placing.corners, letterbox)
    stage.commands.run("place-drag", 0.6, 0.5)  # the drag continues
    moved = np.add(letterbox, (0.1, 0))
    np.testing.assert_allclose(stage.screen.adjusted[-1].corners, moved)
    stage.commands.run("playlist-next")
    stage.advance(0.05)
    np.testing.assert_allclose(stage.session.placing.corners, moved)  # the placement stays, whatever plays
    stage.press("escape")
    assert stage.screen.adjusted[-1].corners is None


def test_the_mouse_pulls_a_corner_or_the_whole_picture(stage: Stage) -> None:
    stage.advance(0.05)
    stage.commands.set("view", "camera")

    def drag(*points: tuple[float, float]) -> np.ndarray:
        for action, (x, y) in zip(("press", *["move"] * (len(points) - 2), "release"), points, strict=True):
            stage.show.point(Pointer(action, x, y))  # type: ignore[arg-type]
        stage.show.step()
        return np.array(stage.session.placing.corners if stage.session.placing else SQUARE)

    np.testing.assert_array_equal(drag((0, 0), (0.2, 0.1), (0.2, 0.1)), SQUARE)  # the picture is not being placed
    stage.press("k")
    expected = np.array(SQUARE, float)
    expected[0] = 0.19, 0.12
    np.testing.assert_allclose(drag((0.01, -0.02), (0.1, 0), (0.2, 0.1), (0.2, 0.1)), expected)
    assert stage.session.placing is not None
    assert stage.session.placing.selected == "upper left corner"
    # corners of an impossible quadrilateral
    np.testing.assert_allclose(drag((0.19, 0.12), (5.0, 5.0), (0.19, 0.12)), expected)
    drag((0.5, 0.5), (0.5, 0.5))
    np.testing.assert_allclose(drag((0.5, 0.5), (0.6, 0.5), (0.6, 0.5)), expected + np.array((0.1, 0)))
    assert stage.session.placing.selected == "whole picture"
    stage.press("u")
    np.testing.assert_allclose(stage.session.placing.corners, expected)  # one undo reverts a whole drag
    stage.press("u")
    np.testing.assert_allclose(stage.session.placing.corners, SQUARE)
    assert stage.press("u") == "nothing to take back"
    stage.commands.set("view", "projector")  # the stage's room doubles positions from this view to the camera's view
    drag((0.5, 0.5), (0.45, 0.45), (0.45, 0.45))
    np.testing.assert_allclose(stage.session.placing.corners[2], (0.9, 0.9))


def test_what_goes_wrong_is_written_only_where_somebody_works_on_the_show() -> None:
    for fullscreen, options, visible in (
        (False, {}, True),
        (True, {}, False),
        (False, {"unattended": True}, False),
        (True, {"unattended": True, "osd": "notices"}, True),
        (False, {"osd": "off"}, False),
    ):
        stage = Stage(**options)
        stage.screen.fullscreen = fullscreen
        stage.advance(0.05)
        stage.press("space")
        stage.advance(2.0)
        stage.session.notice("the decoder stumbled")
        stage.advance(0.1)
        assert (stage.screen.pages[-1] is not None) is visible
        assert stage.session.stats.to_dict()["notices"] == ["the decoder stumbled"]


def test_views_that_are_maps_say_what_their_colours_mean(stage: Stage) -> None:
    stage.advance(0.05)
    stage.press("space")
    stage.advance(2.0)
    for view, count in (("projector", 0), ("camera", 0), ("error", 4), ("impossible", 4)):
        stage.commands.set("view", view)
        stage.advance(0.05)
        page = stage.screen.pages[-1]
        assert (len(page.legends) if page else 0) == count
    stage.expected = "9 of 10 pixels arrive within 1 % of white"
    for view, last in (("error", stage.expected), ("impossible", "does not count")):
        stage.commands.set("view", view)
        stage.advance(0.05)
        assert stage.screen.pages[-1].legends[-1].text == last
    stage.commands.set("view", "projector")
    stage.commands.set("clipping", True)
    stage.advance(0.05)
    assert stage.screen.pages[-1].legends[0].text == "asked for beyond full light"
    for name, value in (("osd", "off"), ("blackout", True), ("compensation", False)):
        before = stage.commands.get(name)
        stage.commands.set(name, value)
        stage.advance(0.05)
        assert stage.screen.pages[-1] is None
        stage.commands.set(name, before)


def test_the_keys_are_listed_page_by_page(stage: Stage) -> None:
    stage.advance(0.05)
    stage.press("space")
    stage.advance(2.0)
    stage.press("?")
    assert "next medium" in "".join(stage.screen.pages[-1].lines)
    stage.press("?")
    assert stage.screen.pages[-1] is None
    stage.screen.size = 216, 384
    shown = []
    while stage.commands.get("help") or not shown:
        stage.press("?")
        shown.append(stage.screen.pages[-1])
    assert shown.pop() is None
    assert len(shown) > 2
    assert {page.lines[-1] for page in shown} == {f"{n} of {len(shown)}; ? goes on" for n in range(1, len(shown) + 1)}


def test_reload_takes_the_new_renderer_with_its_first_frame_or_keeps_the_old(stage: Stage) -> None:
    stage.advance(0.2)
    stage.press("space")
    stage.fresh = [InputError("entries.exr: its SHA-256 differs"), RuntimeError("x.frag:3: syntax\nerror"), Screen()]
    fresh = stage.fresh[-1]
    old, count = stage.session.renderer, len(stage.screen.uploaded)
    assert stage.press("ctrl+r") == "not reloaded: entries.exr: its SHA-256 differs"
    assert stage.press("ctrl+r") == "not reloaded: x.frag:3: syntax error"
    assert stage.session.renderer is old
    assert len(stage.screen.uploaded) == count
    here = stage.screen.uploaded[-1]
    assert stage.press("ctrl+r") == "maps and shaders reloaded"
    assert stage.session.renderer is fresh
    assert stage.screen.released
    assert fresh.uploaded == [here]  # the show is paused, so the same frame comes again
    assert fresh.opened == 1
    assert fresh.adjusted


def test_a_reloaded_renderer_that_cannot_draw_leaves_the_old(stage: Stage) -> None:
    class Broken(Screen):
        def render(self, view: str, **options: Any) -> None:
            raise KeyError("scale")

    stage.advance(0.2)
    stage.fresh, old = [Broken()], stage.session.renderer
    broken, uploaded = stage.fresh[0], len(stage.screen.uploaded)
    assert stage.press("ctrl+r") == "not reloaded: KeyError('scale')"
    assert broken.released
    assert stage.session.renderer is old
    assert not stage.screen.released
    assert len(stage.screen.uploaded) == uploaded + 1  # the frame that the new renderer could not draw
    assert stage.session.stats.notices == ["not reloaded: KeyError('scale')"]


def test_what_reader_and_display_have_to_say_is_reported_at_once(
    stage: Stage, capsys: pytest.CaptureFixture[str]
) -> None:
    stage.show.step()
    stage.reader.news, stage.screen.news = ["decoder stopped; restarted"], ["monitor A has gone"]
    stage.advance(0.05)
    assert capsys.readouterr().err == "decoder stopped; restarted\nmonitor A has gone\n"
    assert stage.session.stats.notices == ["decoder stopped; restarted", "monitor A has gone"]


def test_a_video_ends_and_a_still_stays() -> None:
    video, still = Stage(Reader(count=5)), Stage(Reader(count=1, still=True))
    video.advance(1.0)
    still.advance(1.0)
    assert video.session.done
    assert video.screen.uploaded[-1] == 4
    assert not still.session.done
    assert still.screen.uploaded == [0]
    still.press("right", ".", ",")
    still.advance(0.1)
    assert still.screen.uploaded == [0]


def test_brackets_halve_and_double_the_steps(stage: Stage) -> None:
    stage.advance(0.05)
    for key, steps in (("]", 1), ("]", 2), ("]", 4), ("[", 2), ("[", 1), ("[", 0), ("[", 0)):
        assert stage.press(key) == f"Refine: {steps} steps"
        assert stage.screen.steps[-1] == steps
    stage.refinable = False
    assert stage.press("]").startswith("no refinement: the maps were built without it")


def test_steps_that_follow_the_frame_time_are_counted() -> None:
    still = Stage(Reader(still=True), refine="auto", usual=8)
    still.advance(0.05)
    assert still.screen.steps[-1] == 8  # a still has no next frame to continue in
    stage = Stage(Reader(rate=1 / 3600), refine="auto")
    stage.show.step()
    stage.advance(0.4)
    assert stage.screen.steps[:6] == [1, 2, 3, 4, 5, 6]  # steps cost no time on the stage
    assert stage.commands.get("refine") == "auto"
    stage.commands.set("refine", 5)
    stage.advance(0.12)
    assert stage.screen.steps[-1] == stage.screen.steps[-2] == stage.session.steps == 5
    facts = stage.show.run(limit=len(stage.screen.uploaded)).facts["refinement"]
    assert facts["steps"] == pytest.approx(np.mean(stage.screen.steps), abs=0.05)
    assert facts["certified_db"] == pytest.approx(-20 * np.log10(0.99))
    assert stage.reader.closed


def test_the_certificate_is_measured_now_and_then_and_only_to_be_shown(stage: Stage) -> None:
    stage.advance(0.4)
    assert stage.screen.certified == stage.screen.snapshots == 0
    stage.press("i")
    stage.advance(1.0)
    assert 2 <= stage.screen.certified <= 3
    page = stage.screen.pages[-1]
    assert page is not None
    assert any("dB below the optimum (estimated: all 4 squares" in line for line in page.lines)
    assert any("certified: at most" in line for line in page.lines)
    assert page.histogram is not None
    assert page.histogram.counts[:-1] == stage.session.stats.late_counts
    assert stage.commands.get("gap") == pytest.approx(0.02)
    assert stage.commands.get("psnr") == 40


def test_remotes_are_polled_and_the_heartbeat_informed_when_it_is_due() -> None:
    polls: list[Commands] = []
    beats: list[Mapping[str, object]] = []

    def stop_after_five(commands: Commands) -> None:
        polls.append(commands)
        if len(polls) == 5:
            commands.run("quit")

    remote: Any = SimpleNamespace(poll=stop_after_five)
    heartbeat: Any = SimpleNamespace(beat=beats.append, due=True)
    stage = Stage(remotes=[remote], heartbeat=heartbeat)
    stage.show.run()
    assert len(polls) == len(beats) == 5
    assert beats[-1]["playlist_pos"] == 0
    heartbeat.due = False
    polls.clear()
    stage.session.done = False
    stage.show.run()
    assert len(polls) == len(beats) == 5
    assert {"fps", "frames", "dropped", "gap", "gpu_ms", "time_pos"} <= beats[-1].keys()
    assert "seek" in polls[0].names()
    assert not polls[0].writable("frames")


@pytest.mark.parametrize(("osd", "writes"), [("auto", False), ("on", True)])
def test_a_filled_screen_has_no_text_unless_somebody_asks(osd: str, writes: bool) -> None:
    stage = Stage(osd=osd)
    stage.screen.fullscreen = True
    stage.advance(0.05)
    for key in ("ctrl+wheel-up", "c", "b", "b", "x"):
        stage.press(key)
        stage.advance(0.05)
        assert (stage.screen.pages[-1] is not None) is writes
    stage.commands.run("show-text", "hello")
    stage.advance(0.05)
    assert (stage.screen.pages[-1] is not None) is writes


def test_the_mouse_alone_changes_nothing(stage: Stage) -> None:
    stage.advance(0.05)
    for key in ("double-click", "wheel-up", "wheel-left"):
        assert stage.press(key) == ""
    assert not stage.screen.fullscreen
    stage.press("ctrl+double-click")
    assert stage.screen.fullscreen
