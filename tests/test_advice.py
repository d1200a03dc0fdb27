"""Advice of a report in a room made by hand: areas, causes and figures."""

import numpy as np
import pytest
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.response import Response
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.report.advice import BLUR, Advice, advise
from counterlight.tools.report.impossible import REASONS, Impossible
from counterlight.tools.transport.transport import Transport
from counterlight.tools.ways.footprints import PERIODS
from counterlight.tools.ways.ways import BLURRED, BOUNCED, WAYS, Ways

SHAPE = (20, 30)
WHITE = 0.8
DIM, LEFT, RIGHT = (slice(2, 6), slice(3, 9)), (slice(10, 15), slice(0, 7)), (slice(10, 19), slice(20, 28))
REASON = {reason.name: i for i, reason in enumerate(REASONS)}


def room() -> Tier:
    """Each camera pixel sees its own projector pixel: 0.2 in DIM, 1 elsewhere. Ambient light is 0.16 in LEFT."""
    light, ambient = np.ones(SHAPE, np.float32), np.zeros((*SHAPE, 3), np.float32)
    light[DIM], ambient[LEFT] = 0.2, 0.16
    T = Transport.from_matrices([sparse.csr_array(sparse.diags_array(light.ravel()))] * 3)
    devices = Device(*SHAPE, Response("linear")), Device(*SHAPE, Response("linear"))
    return tier_of(Calibration("room", "made by a test", devices[:1], devices[1], ambient, np.ones(SHAPE, bool)), T)


def found(shares: np.ndarray, contrast: np.ndarray, **areas: list[tuple[slice, slice]]) -> list[Advice]:
    flags = np.zeros((len(REASONS), *SHAPE), bool)
    for reason, parts in areas.items():
        for part in parts:
            flags[REASON[reason]][part] = True
    bounced = np.zeros((*SHAPE, 3))
    bounced[RIGHT] = 0.6, 0.3, 0.1
    ways = Ways(shares, np.ones(SHAPE, bool), np.full(SHAPE, 7.25), contrast, bounced)
    return advise(room(), WHITE, Impossible(flags), ways)


@pytest.fixture
def straight() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((len(WAYS), *SHAPE)), np.ones((*SHAPE, len(PERIODS)))


def test_where_full_light_is_too_little_it_says_how_much(straight: tuple[np.ndarray, np.ndarray]) -> None:
    (advice,) = found(*straight, below_mid_grey=[DIM])
    assert (advice.areas, advice.pixels, advice.box) == (1, 24, (3, 2, 8, 5))
    assert str(advice) == (
        "x 3 to 8, y 2 to 5: 4.0 % of the view cannot be compensated because full light gives 25 % of white there; "
        "lower --white, or add a second projector's light"
    )


def test_bright_black_is_of_the_room_or_bounced(straight: tuple[np.ndarray, np.ndarray]) -> None:
    shares, contrast = straight
    shares[WAYS.index(BOUNCED)][RIGHT] = 0.35
    bounced, lamp = found(shares, contrast, bright_black=[LEFT, RIGHT])
    assert bounced.way is BOUNCED
    assert "35 % of its light bounced off other surfaces (red / green / blue 60 / 30 / 10 %)" in bounced.because
    assert lamp.because == "the room's own light is 20 % of white there"
    assert lamp.remedy == "darken the room"


def test_areas_of_one_cause_are_reported_together_and_the_largest_is_named(
    straight: tuple[np.ndarray, np.ndarray],
) -> None:
    (advice,) = found(*straight, conflict=[LEFT, RIGHT])
    assert (advice.areas, advice.pixels, advice.box) == (2, 35 + 72, (20, 10, 27, 18))
    assert str(advice).startswith("x 20 to 27, y 10 to 18 and 1 more: 17.8 % of the view")


def test_detail_that_arrives_without_contrast_is_reported_where_all_else_can_be_shown(
    straight: tuple[np.ndarray, np.ndarray],
) -> None:
    assert found(*straight) == []
    shares, contrast = straight
    shares[WAYS.index(BLURRED)][RIGHT] = 1
    contrast[RIGHT] = np.array(PERIODS) > 16
    (advice,) = found(shares, contrast)
    assert (advice.reason, advice.way, advice.pixels) == (BLUR, BLURRED, 72)
    assert "stripes of less than 32 projector pixels lose half of their contrast" in advice.because
    assert "blurred over 7.2 projector pixels" in advice.because
    contrast[RIGHT] = 0
    assert "even stripes of 64 projector pixels lose half" in found(shares, contrast)[0].because
