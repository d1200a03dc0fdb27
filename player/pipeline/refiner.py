"""Refinement: two gathers per step, T and Tᵀ, and the step itself; see player/pipeline/refinement.py."""

from functools import cached_property
from typing import Generic, NamedTuple

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray
from counterlight.maps.room_maps import RefinementMaps
from counterlight.passes.certificate import Gap, Weighted
from counterlight.passes.drawing import Canvas, Picture
from counterlight.passes.product import Combining
from counterlight.passes.refinement_step import Slope, Ties
from counterlight.pipeline.device import Device, Owner, Owning, StoredMaps, SumPass
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.shortfall import Snapshot
from counterlight.pipeline.starts import Iterate

ADD: Combining = "ADD_TO_BASE"
SUBTRACT: Combining = "SUBTRACT_FROM_BASE"


class Goal(NamedTuple, Generic[Picture]):
    """The pictures that a drive is compared with.

    b : target of the steps.
    unbounded : target without the limits of each pixel's light.
    plain : drive without compensation.
    """

    b: Picture
    unbounded: Picture
    plain: Picture


class Refiner(Owning, Generic[Picture]):
    """Makes steps from a drive towards the best drive, and certifies how far a drive is from it.

    stored : shared maps T and TᵀW.
    """

    def __init__(self, device: Device[Picture], stored: StoredMaps[Picture], maps: RefinementMaps) -> None:
        self._owner, self._device, self._maps, self._room = Owner(), device, maps, stored.room
        own, projector = self._owner.own, maps.dual.output_shape
        with self._owner:
            self._slope = own(_Slope(stored, maps))
            self._prior = Ties(*(own(device.picture(picture)) for picture in vars(maps.prior).values()))
            self._step = own(device.stepper(projector, self._prior))
            self._step_size = own(device.picture(maps.step_size))

    def run(self, start: Iterate[Picture], b: Picture, steps: int) -> Iterate[Picture]:
        """Return the iterate after `steps` steps from `start`."""
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            descent = self._slope.run(y, b)
            p, y = self._step.run(step, descent, y, p, self._step_size)
        return Iterate(p, y, made + steps)

    def downhill(self, y: Picture, b: Picture) -> Picture:
        """Return TᵀW (b − T y) − P y."""
        return self._downhill.draw(Slope(self._slope.run(y, b), y, self._prior))

    @cached_property
    def curvature(self) -> Picture:
        """1 / step size; 0 where the step size is 0."""
        size = self._maps.step_size
        curvature = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
        return self._owner.own(self._device.picture(curvature))

    def certify(self, p: Picture, goal: Goal[Picture]) -> Certificate:
        """Measure a drive within 0..1; waits for the GPU."""
        return self._certifier.run(self._slope, p, goal)[0]

    def snapshot(self, last: Iterate[Picture], goal: Goal[Picture], steps: int) -> Snapshot:
        """Certify a drive after `steps` steps, with the pictures that an estimate needs; reads four pictures back."""
        certificate, found = self._certifier.run(self._slope, last.p, goal)
        unweighted = np.array(self._device.read(found, np.float32))
        descent = self._slope.run(last.p, goal.b)
        p, y, d = (self._device.read(picture, np.float32) for picture in (last.p, last.y, descent))
        return Snapshot(certificate, p, y, d, unweighted, last.steps, steps)

    @cached_property
    def _downhill(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._maps.dual.output_shape))

    @cached_property
    def _certifier(self) -> "_Certifier[Picture]":
        """The passes of the certificate, built on first use because they hold eight pictures."""
        return self._owner.own(_Certifier(self._device, self._maps, self._room.certified))


class _Slope(Owning, Generic[Picture]):
    """Computes TᵀW (b − T y), with T = S + B P + U M D.

    source : computes b − T y in the form that the maps of TᵀW take.
    gathered : computes TᵀW of a residual from `source`.
    """

    def __init__(self, stored: StoredMaps[Picture], maps: RefinementMaps) -> None:
        self._owner, self._stored = Owner(), stored
        self.source = self._minus("WEIGHED_RESIDUAL" if stored.weighs else SUBTRACT)
        adding: list[Combining] = ["", *(ADD for _ in maps.chains)]
        self.gathered = self._owner.own(SumPass(stored, maps.dual, maps.chains, adding))

    def run(self, y: Picture, b: Picture) -> Picture:
        return self.gathered.run(self.source.run(y, b))

    @cached_property
    def residual(self) -> SumPass[Picture]:
        """The pass of the plain b − T p."""
        return self._minus(SUBTRACT)

    def _minus(self, last: Combining) -> SumPass[Picture]:
        """Return the pass b − T y; `last` says how the last part is combined."""
        maps = self._stored.room.maps
        combining = [*(SUBTRACT for _ in maps.chains), last]
        return self._owner.own(SumPass(self._stored, maps.transport, maps.chains, combining))


class _Certifier(Owning, Generic[Picture]):
    """Computes the unweighted error over the lit camera pixels, its gap and the light outside; sums are read back."""

    def __init__(self, device: Device[Picture], maps: RefinementMaps, lit: BoolArray) -> None:
        (camera, projector), self._owner = (maps.weights.shape, maps.seen.shape), Owner()
        own = self._owner.own
        unweighing = np.divide(1, maps.weights, out=np.zeros_like(maps.weights), where=lit)
        self._gap, self._weighted = (own(device.canvas((projector[0], projector[1]))) for _ in range(2))
        self._squared, self._counted = (own(device.canvas((camera[0], camera[1]))) for _ in range(2))
        self._lit, self._unweighing, self._unseen = (
            own(device.picture(grey(values))) for values in (lit, unweighing, 1 - np.minimum(maps.seen, 1))
        )
        self._of_projector, self._of_camera = (own(device.total((h, w))) for h, w in (projector, camera))

    def run(self, slope: _Slope[Picture], p: Picture, goal: Goal[Picture]) -> tuple[Certificate, Picture]:
        """Return the certificate, and Tᵀ (b − T p) over the lit camera pixels with unlimited b."""
        counted = self._counted.draw(Weighted(slope.source.run(p, goal.unbounded), self._unweighing))
        descent = slope.gathered.run(counted)
        gap = self._of_projector.run(self._gap.draw(Gap(descent, p)))
        squared = self._squared.draw(Weighted(slope.residual.run(p, goal.unbounded), self._lit, squared=True))
        error = np.asarray(self._of_camera.run(squared), np.float64)
        outside, usual = (
            float(np.sum(self._of_projector.run(self._weighted.draw(Weighted(drive, self._unseen)))))
            for drive in (p, goal.plain)
        )
        return Certificate(error, gap, outside / usual if usual > 0 else None), descent


def grey(values: NDArray[np.generic]) -> NDArray[np.float32]:
    """Convert (height, width) to a picture (height, width, 3)."""
    return np.repeat(values[..., None].astype(np.float32), 3, axis=2)
