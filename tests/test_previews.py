"""Preview pictures for remotes: when they are made and what they cost, on a simulated clock."""

import base64
import json

import cv2
import numpy as np
import pytest

from counterlight.show.previews import LEAST_S, MOST_STOLEN, MOST_TIME, Previews
from tests.stage import Reader, Stage

PICTURE = np.stack([*np.meshgrid(np.linspace(30, 200, 24), np.linspace(60, 90, 16)), np.full((16, 24), 120.0)], axis=-1)


class Costly:
    """A renderer whose preview pictures take time on the simulated clock."""

    def __init__(self, stage: Stage, cost_s: float) -> None:
        self.now_s, self.cost_s, self.made = 0.0, cost_s, 0
        stage.screen.small = self.small  # type: ignore[attr-defined]
        stage.screen.small_seen = lambda: None  # type: ignore[attr-defined]

    def small(self) -> np.ndarray:
        self.now_s += self.cost_s
        self.made += 1
        return np.rint(PICTURE).astype(np.uint8)

    def clock(self) -> float:
        return self.now_s


def previews_of(cost_s: float, reader: Reader) -> tuple[Previews, Stage, Costly]:
    stage = Stage(reader)
    costly = Costly(stage, cost_s)
    stage.advance(0.05)
    return Previews(stage.session, costly.clock), stage, costly


def test_a_picture_is_made_once_and_again_when_another_one_is_shown() -> None:
    previews, stage, costly = previews_of(0.001, Reader(still=True))
    preview = previews.take("screen", -1)
    assert preview is not None
    assert json.loads(json.dumps(preview)) == preview
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(str(preview["jpeg"])), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_allclose(shown, PICTURE, atol=8)  # JPEG of quality 75, of a smooth picture
    costly.now_s += 1
    assert previews.take("screen", preview["serial"]) is None  # type: ignore[arg-type]
    stage.commands.set("contrast", 5)
    stage.show.step()
    assert previews.take("screen", preview["serial"])["serial"] != preview["serial"]  # type: ignore[arg-type, index]
    assert previews.take("camera", -1) is None  # the renderer has no such picture


def test_nothing_is_made_before_anything_is_shown() -> None:
    stage = Stage(Reader(opens_s=5.0))
    previews = Previews(stage.session)
    assert previews.take("screen", -1) is None


@pytest.mark.parametrize("cost_s", [0.001, 0.02])
def test_a_show_with_time_left_gives_a_share_of_it(cost_s: float) -> None:
    """A client always asks for a new picture, and receives a fixed share of the time."""
    previews, _, costly = previews_of(cost_s, Reader(still=True))
    while costly.now_s < 60:
        if previews.take("screen", -1) is None:
            costly.now_s += 0.001
    # the client's request comes up to 1 ms late
    assert costly.made * cost_s / costly.now_s == pytest.approx(MOST_TIME, rel=0.1)


def test_a_show_without_time_left_is_disturbed_seldom() -> None:
    """At 25 frames per second, no 50 ms remain between two frames."""
    previews, stage, costly = previews_of(0.05, Reader(count=100_000))
    for _ in range(12):  # until the cost of a picture is known
        costly.now_s += 10
        assert previews.take("screen", -1) is not None
    costly.made, began = 0, costly.now_s
    while costly.now_s < began + 60:
        if previews.take("screen", -1) is None:
            costly.now_s += 0.01
    assert costly.made * 0.05 / (costly.now_s - began) == pytest.approx(
        MOST_STOLEN, rel=0.1
    )  # the client's request comes up to 10 ms late
    assert stage.session.playback is not None
    stage.session.playback.paused = True
    costly.now_s += LEAST_S
    made = costly.made
    for _ in range(4):
        costly.now_s += 1.0
        previews.take("screen", -1)
    assert costly.made == made + 4  # while paused, there is time for previews
