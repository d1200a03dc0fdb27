"""Areas that cannot be compensated, with the cause and a remedy.

An area is connected pixels with one reason of the impossible map, or with detail that arrives without contrast. The
cause follows from the way by which most of the area's light came (tools.ways), and from the light there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.colour.tiers import Tier
from counterlight.tools.report.impossible import REASONS, Impossible
from counterlight.tools.ways.footprints import PERIODS
from counterlight.tools.ways.ways import BENT, BLURRED, BOUNCED, SCATTERED, STRAIGHT, TOLD, WAYS, Way, Ways

LEAST_SHARE = 0.002  # share of the view; smaller areas are edges
MOST = 8  # sentences of advice at most
SHARP = 8.0  # projector pixels: finer stripes lose contrast in any room
BLUR = "lost_detail"


@dataclass(frozen=True)
class Advice:
    """Areas with one reason and one way of light.

    reason : one of REASONS, or lost_detail.
    pixels, share : pixels of all areas, and their share.
    box : left, top, right, bottom of the largest area, camera pixels, inclusive.
    """

    reason: str
    way: Way
    areas: int
    pixels: int
    share: float
    box: tuple[int, int, int, int]
    because: str
    remedy: str

    def __str__(self) -> str:
        left, top, right, bottom = self.box
        more = f" and {self.areas - 1} more" if self.areas > 1 else ""
        where = f"x {left} to {right}, y {top} to {bottom}{more}: {100 * self.share:.1f} % of the view"
        return f"{where} cannot be compensated because {self.because}; {self.remedy}"

    def to_json(self) -> dict[str, Any]:
        return vars(self) | {"way": self.way.name, "box": list(self.box), "words": str(self)}


def advise(tier: Tier, white: float, impossible: Impossible, ways: Ways) -> list[Advice]:
    """Returns one advice per reason and way, the most pixels first.

    white : white level of the maps.
    """
    found: dict[tuple[str, str], list[tuple[Way, BoolArray]]] = {}
    for reason, area in _areas(impossible, ways):
        way = _way(ways, area)
        found.setdefault((reason, way.name), []).append((way, area))
    said = [_said(tier, white, ways, reason, areas) for (reason, _), areas in found.items()]
    return sorted(said, key=lambda each: -each.pixels)[:MOST]


def _areas(impossible: Impossible, ways: Ways) -> Iterator[tuple[str, BoolArray]]:
    shown = {reason.name: impossible.first == 1 + i for i, reason in enumerate(REASONS)}
    shown[BLUR] = (impossible.first == 0) & ways.lit & (ways.finest() > SHARP)
    for reason, where in shown.items():
        labels, count = ndimage.label(where)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)
        for label in range(1, count + 1):
            if sizes[label] >= max(LEAST_SHARE * labels.size, 2):
                yield reason, labels == label


def _way(ways: Ways, area: BoolArray) -> Way:
    shares = ways.shares[:, area].mean(axis=1)
    return WAYS[int(shares.argmax())] if shares.max() >= TOLD else STRAIGHT


def _said(tier: Tier, white: float, ways: Ways, reason: str, areas: list[tuple[Way, BoolArray]]) -> Advice:
    way, largest = max(areas, key=lambda each: int(each[1].sum()))
    whole = np.any([area for _, area in areas], axis=0)
    (top, bottom), (left, right) = ((int(each.min()), int(each.max())) for each in np.nonzero(largest))
    box, pixels = (left, top, right, bottom), int(whole.sum())
    words = _words(reason, way, _Light.of(tier, white, ways, whole))
    return Advice(reason, way, len(areas), pixels, pixels / whole.size, box, *words)


@dataclass(frozen=True)
class _Light:
    """Medians of an area, in shares of white unless stated.

    bounced : share of the area's light.
    radius, finest : projector pixels.
    tint : (3,). Bounced light by channel; the sum is 1.
    """

    reach: float
    ambient: float
    bounced: float
    radius: float
    finest: float
    tint: FloatArray

    @classmethod
    def of(cls, tier: Tier, white: float, ways: Ways, area: BoolArray) -> "_Light":
        reach, ambient = tier.reach.min(axis=2)[area], tier.ambient.max(axis=2)[area]
        tint = ways.bounced[area].sum(axis=0)
        return cls(
            float(np.median(reach)) / white,
            float(np.median(ambient)) / white,
            float(np.mean(ways.shares[WAYS.index(BOUNCED), area])),
            float(np.median(ways.radius[area])),
            float(np.median(ways.finest()[area])),
            tint / max(float(tint.sum()), 1e-12),
        )


def _words(reason: str, way: Way, light: _Light) -> tuple[str, str]:
    """Returns the cause and the remedy."""
    match reason:
        case "unlit":
            if way is BOUNCED:
                return "only light that bounced reaches it: a shadow", "let a second projector fill it"
            return "no light of the projector reaches it, or it does not count", "turn the projector, or add another"
        case "below_mid_grey" | "below_white":
            through = " by glass or a mirror" if way is BENT else ""
            because = f"full light{through} gives {100 * light.reach:.0f} % of white there"
            return because, "lower --white, or add a second projector's light"
        case "bright_black":
            return _black_words(light)
        case "conflict":
            return _shared_words(way, light), _sharper(way)
        case _:
            finite = np.isfinite(light.finest)
            fine = f"stripes of less than {light.finest:.0f}" if finite else f"even stripes of {PERIODS[-1]}"
            lost = f"{fine} projector pixels lose half of their contrast"
            return f"{lost}, which no drive gives back: {_shared_words(way, light)}", _sharper(way)


def _black_words(light: _Light) -> tuple[str, str]:
    if light.ambient > TOLD / 2:
        return f"the room's own light is {100 * light.ambient:.0f} % of white there", "darken the room"
    tint = " / ".join(f"{100 * each:.0f}" for each in light.tint)
    because = f"{100 * light.bounced:.0f} % of its light bounced off other surfaces (red / green / blue {tint} %)"
    return f"{because}: what is darker cannot be shown", "darken those surfaces, or what is shown on them"


def _shared_words(way: Way, light: _Light) -> str:
    spread = f"over {light.radius:.1f} projector pixels"
    return {
        BENT.name: "glass or a mirror brings it light that goes elsewhere, too",
        SCATTERED.name: f"light scatters below the surface {spread}",
        BLURRED.name: f"light is blurred {spread}",
        BOUNCED.name: f"{100 * light.bounced:.0f} % of its light bounced off other surfaces",
    }.get(way.name, "places that should differ share projector pixels, at edges or in fine paint")


def _sharper(way: Way) -> str:
    return {
        BENT.name: "move the glass, or show nothing bright there",
        SCATTERED.name: "show less detail there",
        BLURRED.name: "focus there, or stop the projector's lens down",
        BOUNCED.name: "darken what it bounces off",
    }.get(way.name, "a projector of more pixels would tell them apart")
