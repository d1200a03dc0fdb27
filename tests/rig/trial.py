"""One trial: the product acquires a room, builds, shows pictures under each fault, and is judged."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.rig import product
from tests.rig.asked import Asked
from tests.rig.faults import Fault
from tests.rig.judge import Figures, Judge, Outside
from tests.rig.optimum import Problem, box_optimum
from tests.rig.pictures import PICTURES, Picture
from tests.rig.rig import Rig
from tests.rig.rooms import Room

TOLERANCE = 0.01  # share of the optimum's squared error: 0.04 dB
AMPLIFIED = 8  # factor of the errors in a sheet
SWEPT = "astronaut"  # picture for several step counts: bright up to the raster's border


@dataclass(frozen=True)
class Verdict:
    """The figures of one picture.

    product, optimum : figures of the product's picture and of the best picture, both in 8-bit codes.
    beside, plain_beside : light outside the picture, of the product and of the uncompensated picture.
    by_steps, beside_by_steps : the same by the number of refinement steps, for one picture.
    checked : the product's figures after one check of the room, if something has changed since the acquisition.
    colour : --colour of the build; empty for the default.
    """

    room: str
    fault: str
    picture: str
    product: Figures
    optimum: Figures
    beside: Outside
    plain_beside: Outside
    by_steps: dict[int, Figures]
    beside_by_steps: dict[int, Outside]
    checked: Figures | None = None
    colour: str = ""

    @property
    def distance(self) -> float:
        """dB below the rig's own optimum."""
        return self.optimum.psnr - self.product.psnr


def trial(
    room: Room,
    faults: Sequence[Fault],
    folder: Path,
    steps: Sequence[int],
    sheets: Path | None,
    colours: Sequence[str] = ("",),
) -> Iterator[Verdict]:
    """Try faults that share a calibration on all pictures; fills `folder`.

    sheets : folder for sheets of pictures; None for none.
    colours : the calibration is built with each of them.
    """
    rig = Rig(room, faults[0].devices)
    product.acquire(rig, folder, *given(faults[0], folder))
    for colour in colours:
        product.build(folder, colour)
        for verdict in _judged(rig, faults, folder, steps, sheets and sheets / colour):
            yield replace(verdict, colour=colour)


def _judged(
    rig: Rig, faults: Sequence[Fault], folder: Path, steps: Sequence[int], sheets: Path | None
) -> Iterator[Verdict]:
    """Yield the verdicts of a room as it was built."""
    if sheets is not None:
        sheets.mkdir(parents=True, exist_ok=True)
    for fault in faults:
        changed = fault.now != fault.devices
        now = rig.after(fault.now) if changed else rig
        judge, pictures = Judge(now), [make(rig.camera) for make in PICTURES.values()]
        verdicts = []
        for picture in pictures:
            picture.write(folder / f"{picture.name}.png")
            seen = _Seen(judge, picture, folder)
            verdicts.append(seen.verdict(fault.name, steps if picture.name == SWEPT else ()))
            if sheets is not None:
                seen.draw(sheets / f"{rig.room.name}-{fault.name}-{picture.name}.png")
        yield from _after_a_check(judge, pictures, verdicts, folder) if changed else verdicts


def _after_a_check(
    judge: Judge, pictures: Sequence[Picture], verdicts: Sequence[Verdict], folder: Path
) -> Iterator[Verdict]:
    """Yield the verdicts, with the product's figures after a check of the room in its present state."""
    product.check(judge.rig, folder)
    for picture, verdict in zip(pictures, verdicts, strict=True):
        path = folder / f"{picture.name}.png"
        shown = product.show(folder, path)
        white = shown.white * _unit(judge.rig, folder)
        question = judge.asks(picture, white, product.show_plain(folder, path).codes)
        yield replace(verdict, checked=judge.figures(question, shown.codes))
    product.forget(folder)


def given(fault: Fault, folder: Path) -> tuple[str, ...]:
    if fault.given == "table":
        table = fault.devices.projector.response_table()
        return "--response", str(product.write_response(folder / "response.toml", table))
    return ("--response", fault.given) if fault.given else ()


def _unit(rig: Rig, folder: Path) -> float:
    """Returns the rig's radiance per radiance of the product.

    The captures of a camera with an unknown curve do not tell the light of its largest code, so its unit is arbitrary.
    """
    if rig.devices.stored.curve == "linear":
        return 1.0
    own, white = product.floodlight(folder), np.full((*rig.raster, 3), 255, np.uint8)
    rise = (rig.seen(white) - rig.seen(np.zeros_like(white))).reshape(own.shape)
    return float(np.vdot(own, rise) / np.vdot(own, own))


class _Seen:
    """A picture in a room: as the product shows it by default, as any player would, and at its best."""

    def __init__(self, judge: Judge, picture: Picture, folder: Path) -> None:
        self._judge, self._rig, self._picture = judge, judge.rig, picture
        self._folder, self._path = folder, folder / f"{picture.name}.png"
        self._shown = product.show(folder, self._path)
        self._plain = product.show_plain(folder, self._path).codes
        self._question = judge.asks(picture, self._shown.white * _unit(judge.rig, folder), self._plain)
        self._best = _best(judge.rig, self._question.near)

    def verdict(self, fault: str, steps: Sequence[int]) -> Verdict:
        tried = {count: product.show(self._folder, self._path, *product.refining(count)).codes for count in steps}
        return Verdict(
            self._rig.room.name,
            fault,
            self._picture.name,
            self._judge.figures(self._question, self._shown.codes),
            self._judge.figures(self._question, self._best),
            self._judge.outside(self._question, self._shown.codes),
            self._judge.outside(self._question, self._plain),
            {count: self._judge.figures(self._question, codes) for count, codes in tried.items()},
            {count: self._judge.outside(self._question, codes) for count, codes in tried.items()},
        )

    def draw(self, path: Path) -> None:
        """Draw a sheet of the audience's view: target, plain, product; optimum, the product's error × 8, its drive."""
        wide = self._question.wide
        plain, product_, best = (
            self._rig.seen_by_audience(codes) for codes in (self._plain, self._shown.codes, self._best)
        )
        error = np.abs(wide.error(product_)) / wide.white * AMPLIFIED
        drawn = [self._drawn(light, wide.white) for light in (wide.most, plain, product_, best)]
        size = drawn[0].shape[1::-1]
        drawn.append(np.rint(255 * np.clip(error, 0, 1)).astype(np.uint8).reshape(drawn[0].shape))
        drawn.append(np.asarray(cv2.resize(self._shown.codes, size, interpolation=cv2.INTER_NEAREST), np.uint8))
        sheet = np.concatenate([np.concatenate(drawn[:3], axis=1), np.concatenate(drawn[3:], axis=1)])
        assert cv2.imwrite(str(path), np.ascontiguousarray(sheet[..., ::-1])), path

    def _drawn(self, light: NDArray[np.float64], white: float) -> NDArray[np.uint8]:
        return self._judge.srgb(light, white).reshape(*self._rig.room.lattice.audience, 3)


def _best(rig: Rig, asked: Asked) -> NDArray[np.uint8]:
    projector = rig.devices.projector
    limits = projector.lamp * projector.black, projector.lamp
    problem = Problem(rig.transport, asked.most - rig.ambient, asked.counted, *limits)
    return projector.nearest_codes(box_optimum(problem, TOLERANCE).drive, rig.raster)
