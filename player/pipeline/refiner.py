"""Refinement: two gathers per step, T and Tᵀ, and the step itself; see player/pipeline/refinement.py."""

from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RefinementMaps
from counterlight.pipeline.device import ChainPass, Device, Light, Owner, Pass, StoredMaps
from counterlight.pipeline.reference import inverse
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.shortfall import Snapshot
from counterlight.pipeline.starts import Iterate

SUBTRACT = "SUBTRACT_FROM_BASE"


class Goal(NamedTuple):
    """The pictures that a drive is measured against.

    b : target of the steps.
    unbounded : target without the limits of what each pixel can have.
    plain : drive without compensation.
    """

    b: Light
    unbounded: Light
    plain: Light


class Refiner:
    """Makes steps from a drive towards the best drive, and certifies how far a drive is from it.

    stored : shared maps T and TᵀW.
    """

    def __init__(self, device: Device, stored: StoredMaps, maps: RefinementMaps) -> None:
        self._owner, self._device = Owner(), device
        own, projector = self._owner.own, maps.dual.output_shape
        try:
            self._slope = own(_Slope(stored, maps))
            self._prior = {name: own(device.picture(picture)) for name, picture in vars(maps.prior).items()}
            self._step = own(device.stepper(projector, self._prior))
            self._step_size = own(device.picture(maps.step_size))
            self._make_downhill = partial(device.make_pass, "refinement_step.frag", projector, {"SLOPE": None})
            self._make_curvature = partial(_curvature, device, maps.step_size)
            self._make_certifier = partial(_Certifier, device, maps)
        except BaseException:
            self.release()
            raise

    def run(self, start: Iterate, b: Light, steps: int) -> Iterate:
        """Return the iterate after `steps` steps from `start`."""
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            _, descent = self._slope.run(y, b)
            p, y = self._step.run(step, descent, y, p, self._step_size)
        return Iterate(p, y, made + steps)

    def downhill(self, y: Light, b: Light) -> Light:
        """Return TᵀW (b − T y) − P y."""
        return self._against_gradient(self._slope.run(y, b)[1], y)

    @cached_property
    def curvature(self) -> Light:
        """1 / step size; 0 where the step size is 0."""
        return self._owner.own(self._make_curvature())

    def certify(self, p: Light, goal: Goal) -> Certificate:
        """Measure a drive within 0..1; waits for the GPU."""
        return self._certifier.run(self._slope, p, goal)[0]

    def snapshot(self, last: Iterate, goal: Goal, steps: int) -> Snapshot:
        """Certify a drive after `steps` steps, with the pictures that an estimate needs; reads four pictures back."""
        certificate, found = self._certifier.run(self._slope, last.p, goal)
        unweighted = np.array(self._device.read(found, np.float32))
        descent = self._slope.run(last.p, goal.b)[1]
        p, y, d = (self._device.read(picture, np.float32) for picture in (last.p, last.y, descent))
        return Snapshot(certificate, p, y, d, unweighted, last.steps, steps)

    def _against_gradient(self, descent: Light, y: Light) -> Light:
        return self._downhill.run(descent=descent, y=y, **self._prior)

    @cached_property
    def _downhill(self) -> Pass:
        return self._owner.own(self._make_downhill())

    @cached_property
    def _certifier(self) -> "_Certifier":
        """Built on first use: it holds eight pictures that only shows with figures need."""
        return self._owner.own(self._make_certifier())

    def release(self) -> None:
        self._owner.release()


class _Slope:
    """Computes b − T y and TᵀW (b − T y), with T = S + B P + U M D."""

    def __init__(self, stored: StoredMaps, maps: RefinementMaps) -> None:
        self._owner, self._stored = Owner(), stored
        own = self._owner.own
        self._residual = own(_Residual(stored, "WEIGHED_RESIDUAL" if stored.weighs else SUBTRACT))
        self._dual = own(stored.of(maps.dual).product())
        self._chains = [own(ChainPass(stored, chain, "ADD_TO_BASE")) for chain in maps.chains]

    def run(self, y: Light, b: Light) -> tuple[Light, Light]:
        """Return the residual (weighted if the maps weigh) and the slope."""
        residual = self.source(y, b)
        return residual, self.gathered(residual)

    def source(self, y: Light, b: Light) -> Light:
        """Return b − T y in the form that the maps of TᵀW take."""
        return self._residual.run(y, b)

    def gathered(self, residual: Light) -> Light:
        """Return TᵀW of a residual from `source`."""
        descent = self._dual.run(residual)
        for chain in self._chains:
            descent = chain.run(residual, descent)
        return descent

    def residual(self, p: Light, b: Light) -> Light:
        """Return the plain b − T p."""
        return self._plain.run(p, b)

    @cached_property
    def _plain(self) -> "_Residual":
        return self._owner.own(_Residual(self._stored, SUBTRACT))

    def release(self) -> None:
        self._owner.release()


class _Residual:
    """Computes b − T y; `last` says how the last part is combined."""

    def __init__(self, stored: StoredMaps, last: str) -> None:
        self._owner, maps = Owner(), stored.room.maps
        own, combined = self._owner.own, [*[SUBTRACT] * len(maps.chains), last]
        self._near = own(stored.of(maps.transport).product(combined[0]))
        pairs = zip(maps.chains, combined[1:], strict=True)
        self._chains = [own(ChainPass(stored, chain, how)) for chain, how in pairs]

    def run(self, y: Light, b: Light) -> Light:
        residual = self._near.run(y, b)
        for chain in self._chains:
            residual = chain.run(y, residual)
        return residual

    def release(self) -> None:
        self._owner.release()


class _Certifier:
    """Computes the unweighted error over the lit camera pixels, its gap and the light outside; sums are read back."""

    def __init__(self, device: Device, maps: RefinementMaps) -> None:
        (camera, projector), self._owner = (maps.weights.shape, maps.seen.shape), Owner()
        own, lit = self._owner.own, maps.lit > 0
        unweighing = np.divide(1, maps.weights, out=np.zeros_like(maps.weights), where=lit)
        self._gap = own(device.make_pass("gap.frag", (projector[0], projector[1])))
        self._squared, self._counted = (
            own(device.make_pass("weighted.frag", (camera[0], camera[1]), defines))
            for defines in ({"SQUARED": None}, {})
        )
        self._weighted = own(device.make_pass("weighted.frag", (projector[0], projector[1])))
        self._lit, self._unweighing, self._unseen = (
            own(device.picture(grey(values))) for values in (lit, unweighing, 1 - np.minimum(maps.seen, 1))
        )
        self._of_projector, self._of_camera = (own(device.total((h, w))) for h, w in (projector, camera))

    def run(self, slope: _Slope, p: Light, goal: Goal) -> tuple[Certificate, Light]:
        """Return the certificate, and Tᵀ (b − T p) over the lit camera pixels with unlimited b."""
        counted = self._counted.run(picture=slope.source(p, goal.unbounded), weights=self._unweighing)
        descent = slope.gathered(counted)
        gap = self._of_projector.run(self._gap.run(descent=descent, p=p))
        squared = self._squared.run(picture=slope.residual(p, goal.unbounded), weights=self._lit)
        error = np.asarray(self._of_camera.run(squared), np.float64)
        outside, usual = (
            float(np.sum(self._of_projector.run(self._weighted.run(picture=drive, weights=self._unseen))))
            for drive in (p, goal.plain)
        )
        return Certificate(error, gap, outside / usual if usual > 0 else None), descent

    def release(self) -> None:
        self._owner.release()


def grey(values: NDArray[np.generic]) -> NDArray[np.float32]:
    """Convert (height, width) to a picture (height, width, 3)."""
    return np.repeat(values[..., None].astype(np.float32), 3, axis=2)


def _curvature(device: Device, step_size: NDArray[np.float32]) -> Light:
    return device.picture(inverse(step_size))
