"""The advice about late frames fits the player's settings."""

import pytest

from counterlight.show.lateness import WATCHED_S, Lateness
from counterlight.show.stats import Stats


@pytest.mark.parametrize("adapts", [True, False])
def test_fewer_steps_are_advised_only_if_the_user_chooses_them(adapts: bool) -> None:
    stats = Stats()
    lateness = Lateness(stats, 25.0, 0.0)
    stats.frames, stats.dropped = 10, 90
    stats.add("gpu", 0.2)
    line = lateness.advice(WATCHED_S, 5, 3, adapts=adapts)
    assert line is not None
    assert "drawing takes 200 ms with 5 steps" in line
    assert ("fewer steps" in line) is not adapts
