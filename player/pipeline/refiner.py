"""Refinement: two gathers a step, T and Tᵀ, and the step itself; see player/pipeline/refinement.py."""

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RefinementMaps
from counterlight.pipeline.device import Device, FarPass, Light, Owner, StoredMaps
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.starts import Iterate


class Refiner:
    """Steps from a drive towards the best one, and says how far from it a drive can be.

    stored : T and Tᵀ, which others read as well.  mask : (camera height, camera width).
    """

    def __init__(
        self,
        device: Device,
        stored: StoredMaps,
        maps: RefinementMaps,
        mask: NDArray[np.bool_],
    ) -> None:
        self._owner = Owner()
        own, projector = self._owner.own, maps.dual.output_shape
        try:
            self._slope = own(_Slope(stored, maps))
            self._step = own(device.stepper(projector, maps.step_size))
            self._certifier = own(_Certifier(device, projector, mask))
        except BaseException:
            self.release()
            raise

    def run(self, start: Iterate, b: Light, steps: int) -> Iterate:
        """Where `steps` steps from `start` lead."""
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            _, descent = self._slope.run(y, b)
            p, y = self._step.run(step, descent, y, p)
        return Iterate(p, y, made + steps)

    def certify(self, p: Light, b: Light) -> Certificate:
        """Measure a drive within 0..1; waits for the GPU."""
        residual, descent = self._slope.run(p, b)
        return self._certifier.run(residual, descent, p)

    def release(self) -> None:
        self._owner.release()


class _Slope:
    """b − T y and Tᵀ(b − T y), T = S + U M D."""

    def __init__(self, stored: StoredMaps, maps: RefinementMaps) -> None:
        self._owner = Owner()
        own, far = self._owner.own, stored.room.maps.far
        self._residual = own(stored.of(stored.room.maps.transport).product("SUBTRACT_FROM_BASE"))
        self._dual = own(stored.of(maps.dual).product())
        self._far = self._far_dual = None
        if far is not None and maps.far_dual is not None:
            self._far = own(FarPass(stored, far, "SUBTRACT_FROM_BASE"))
            self._far_dual = own(FarPass(stored, maps.far_dual, "ADD_TO_BASE"))

    def run(self, y: Light, b: Light) -> tuple[Light, Light]:
        residual = self._residual.run(y, b)
        if self._far is None or self._far_dual is None:
            return residual, self._dual.run(residual)
        residual = self._far.run(y, residual)
        return residual, self._far_dual.run(residual, self._dual.run(residual))

    def release(self) -> None:
        self._owner.release()


class _Certifier:
    """The gap and the squared error, summed over the picture and read back."""

    def __init__(self, device: Device, projector: tuple[int, int], mask: NDArray[np.bool_]) -> None:
        camera = mask.shape[0], mask.shape[1]
        self._owner = Owner()
        own = self._owner.own
        self._gap = own(device.make_pass("gap.frag", projector))
        self._squared = own(device.make_pass("squared_error.frag", camera))
        self._mask = own(device.mask(mask))
        self._of_gap, self._of_squares = own(device.total(projector)), own(device.total(camera))

    def run(self, residual: Light, descent: Light, p: Light) -> Certificate:
        gap = self._of_gap.run(self._gap.run(descent=descent, p=p))
        return Certificate(self._of_squares.run(self._squared.run(residual=residual, mask=self._mask)), gap)

    def release(self) -> None:
        self._owner.release()
