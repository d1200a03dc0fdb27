"""An evening in rounds of a minute: three people use the remote, a stream is cut off, a monitor is unplugged.

Each person sends a random command of the page per second. After each round, the settings return to those of a show.
A moving picture must then be on its monitor, heartbeats must be in time, and memory must not have grown.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.tools import build_correction_map
from tests import screens
from tests.desktop import screen, xrandr
from tests.fuzz.heart import Heart
from tests.fuzz.tally import CRASHED, GREEDY, HUNG, LEFT, READ, WRONG, Plan, Tally, Trial
from tests.media import numbered, write_video
from tests.programs import PATIENCE_S, descendants, wait_until
from tests.rooms import write_blurred_room
from tests.test_live import Sender, udp_port
from tests.web_remote import Place, Visitor, show_with_remote

PEOPLE, ROUND_S = 3, 45
CUT_AT, UNPLUGGED = 10, range(20, 26)  # seconds of a round in which the stream is cut, and the monitor is away
WARM_UP, MOST_GROWTH = 5, 10 << 20  # rounds before memory is compared; largest growth in bytes
SECOND_MONITOR = 1280, 0, 1024, 768
SHOW: dict[str, object] = {
    **{"blackout": False, "pause": False, "view": "projector", "compensation": True, "test-card": "no", "speed": 1.0},
    **{"brightness": 0, "contrast": 0, "gamma": 0, "saturation": 0, "black-level": 0.0, "adapt": 0.0},
    **{"refine": "auto", "loop-file": False, "ab-loop-a": "no", "ab-loop-b": "no", "image-display-duration": 5.0},
    **{"corners": None, "flicker": 0.0, "clipping": False, "budget": "no", "within": "no"},
    **{"monitor": "DUMMY1", "fullscreen": True, "loop-playlist": True},
}
# paths, and properties whose kind gives no random values
HANDS_OFF = {"lut", "corners", "monitor", "loop-playlist", "osd"}
DARK = 20  # code value; the clip's pictures have brighter places


class Evening:
    """Each trial is a round."""

    name, count = "evening", 3
    purpose = "three people at the remote, a stream cut off, a monitor gone and back; a minute each"

    def run(self, plan: Plan) -> Tally:
        tally, sizes = Tally(self.name, plan), []
        with (
            screens.two_monitors(plan.scratch) as display,
            _show(plan.scratch, display) as (process, place, media, port),
        ):
            heart = Heart(plan.scratch / "show.log")
            children = descendants(process.pid)
            for index in plan.indices():
                trial = _round(plan.rng(self.name, index), process, place, media, display, port, heart)
                tally.add(index, trial)
                sizes.append(heart.resident)
                if trial.verdict == CRASHED:
                    break
            if process.poll() is None:
                with place.visit() as visitor:
                    visitor.ask("quit")
                code = process.wait(PATIENCE_S)
                if code:
                    tally.add(plan.first, Trial(CRASHED, f"exit code {code}"))
            left = [str(pid) for pid in children if Path(f"/proc/{pid}").exists()]
            if left:
                tally.add(plan.first, Trial(LEFT, ", ".join(left)))
        grown = max(sizes[-WARM_UP:]) - max(sizes[:WARM_UP])
        if grown > MOST_GROWTH:
            tally.add(plan.first, Trial(GREEDY, f"{grown / 2**20:.1f} MiB"))
        tally.slowest_s, tally.peak = heart.longest_s, max(sizes)
        tally.notes["MiB"] = " ".join(str(size >> 20) for size in sizes[:: max(1, len(sizes) // 8)])
        tally.notes |= {"grown": f"{grown / 2**20:+.1f} MiB", "frames": heart.frames, "dropped": heart.dropped}
        return tally


def _round(
    rng: np.random.Generator, process: Any, place: Place, media: list[str], display: str, port: int, heart: Heart
) -> Trial:
    asked = 0
    with ExitStack() as stack:
        people = [stack.enter_context(place.visit()) for _ in range(PEOPLE)]
        stream = stack.enter_context(ExitStack())
        stream.enter_context(Sender(port, (320, 240), loss=0.01))
        for second in range(ROUND_S):
            began = time.monotonic()
            if second == CUT_AT:
                stream.close()
            if second in (UNPLUGGED[0], UNPLUGGED[-1]):
                _plug(display, on=second != UNPLUGGED[0])
            for person in people:
                person.ask(*_request(rng, person, media))
                asked += 1
            heart.look()
            if process.poll() is not None:
                return Trial(CRASHED, f"the show ended with {process.returncode}")
            time.sleep(max(0.0, began + 1 - time.monotonic()))
        return _calm(process, people[0], media, display, heart, asked)


def _calm(process: Any, visitor: Visitor, media: list[str], display: str, heart: Heart, asked: int) -> Trial:
    """Reset the show to the state for an audience, and judge the round."""
    for name, value in SHOW.items():
        answer = visitor.ask("set_property", name, value)
        if answer["error"] != "success":
            return Trial(WRONG, f"{name}: {answer}")
    visitor.ask("place-cancel")
    visitor.ask("loadfile", media[0], "replace")
    for medium in media[1:]:
        visitor.ask("loadfile", medium, "append")
    try:
        wait_until(lambda: visitor.get("path") == media[0], "the medium", process)
        before = visitor.get("frames")
        wait_until(lambda: visitor.get("frames") > before + 20, "frames", process)
        wait_until(lambda: screen(display, SECOND_MONITOR).max() > DARK, "a picture on the monitor", process)
    except AssertionError as error:
        return Trial(HUNG, f"not there within {PATIENCE_S:.0f} s: {error}")
    heart.look()
    late = heart.longest_s > 3.0  # allowed: a second between beats, plus a delay of two seconds
    return Trial(HUNG, f"{heart.longest_s:.1f} s between beats") if late else Trial(READ, f"{asked} commands")


def _request(rng: np.random.Generator, visitor: Visitor, media: list[str]) -> list[object]:
    """Return a random request that the page can send."""
    known = next(event for event in visitor.events if event["event"] == "known") if visitor.events else None
    if known is None:
        return ["get_property", "frames"]
    if rng.integers(3):
        writable = [each for each in known["properties"].values() if each["writable"] and each["name"] not in HANDS_OFF]
        info = writable[rng.integers(len(writable))]
        return ["set_property", info["name"], drawn_value(rng, info)]
    share = lambda: float(rng.uniform(-0.2, 1.2))  # noqa: E731 - beyond the view, too
    offers: list[list[object]] = [
        *(
            [name]
            for name in ("playlist-next", "playlist-prev", "frame-step", "frame-back-step", "ab-loop", "identify")
        ),
        *(
            [name]
            for name in ("reload", "place", "place-undo", "place-fit", "place-cancel", "place-release", "check-room")
        ),
        *(["preview", kind, -1] for kind in ("screen", "camera")),
        ["seek", float(rng.uniform(-3, 30)), "absolute"],
        ["place-grab", share(), share()],
        ["place-drag", share(), share()],
        ["loadfile", media[rng.integers(len(media))], ("replace", "append")[rng.integers(2)]],
        ["loadfile", "no such film.mkv", "append"],
        ["show-text", "hello", 500],
        ["projector", "on"],
    ]
    return offers[rng.integers(len(offers))]


def drawn_value(rng: np.random.Generator, info: dict[str, Any]) -> object:
    """Return a random value that fits a property's description (registry.py); nonsense if it has no kind."""
    choices = info.get("choices") or []
    if info["type"] == "flag":
        return bool(rng.integers(2))
    if info["type"] == "choice" or (choices and not rng.integers(3)):
        return choices[rng.integers(len(choices))]
    if info["type"] not in ("integer", "number"):
        return "nonsense"
    top = 100.0 if info["max"] is None else min(info["max"], 1e4)
    drawn = float(rng.uniform(info["min"], top))
    return round(drawn) if info["type"] == "integer" else drawn


def _plug(display: str, *, on: bool) -> None:
    how = ("--mode", "1024x768", "--pos", "1280x0") if on else ("--off",)
    xrandr(display, "--output", "DUMMY1", *how)


@contextmanager
def _show(folder: Path, display: str) -> Iterator[tuple[Any, Place, list[str], int]]:
    write_blurred_room(folder / "room", np.random.default_rng(7), (44, 60), (37, 50))
    assert build_correction_map.main([str(folder / "room"), "--regularize", "0.1"]) == 0
    clips = [f"{n}.mkv" for n in range(2)]
    for clip, shape in zip(clips, [(48, 64), (96, 128)], strict=True):
        write_video(folder / clip, [numbered(i, *shape) for i in range(250)])
    port = udp_port()
    media = [*clips, f"udp://127.0.0.1:{port}"]
    where = "--fullscreen", "--any-size", "--monitor", "DUMMY1", "--loop", "--heartbeat", folder / "show.log"
    with show_with_remote(display, folder, folder / "room", *media, *where) as (process, place):
        yield process, place, media, port
