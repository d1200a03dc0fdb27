"""Refinement on the GPU: two gathers a step, T and Tᵀ, and the step itself; see player/refinement.py."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.passes import Owner, Pass, ScreenPass, float_texture, integer_texture, picture_texture
from counterlight.gl.paths import FarPass, StoredMaps
from counterlight.gl.starts import Iterate
from counterlight.maps import RefinementMaps
from counterlight.refinement import OVER_RELAXATION, Certificate, momentum

BLOCK = 16


class Refiner:
    """Steps from a drive towards the best one, and says how far from it a drive can be.

    stored : T and Tᵀ, which others read as well.  mask : (camera height, camera width).
    """

    def __init__(
        self,
        context: moderngl.Context,
        stored: StoredMaps,
        maps: RefinementMaps,
        mask: NDArray[np.bool_],
    ) -> None:
        self._owner = Owner()
        own, projector = self._owner.own, maps.dual.output_shape
        try:
            self._slope = own(_Slope(stored, maps))
            self._step_size = own(picture_texture(context, maps.step_size))
            uniforms = {"over_relaxation": OVER_RELAXATION}
            self._step = own(ScreenPass(context, "refinement_step.frag", uniforms=uniforms))
            self._targets = [own(_Target(context, projector)) for _ in range(2)]
            self._certifier = own(_Certifier(context, projector, mask))
        except BaseException:
            self.release()
            raise

    def run(self, start: Iterate, b: moderngl.Texture, steps: int) -> Iterate:
        """Where `steps` steps from `start` lead."""
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            _, descent = self._slope.run(y, b)
            following = self._targets[step % 2]
            following.framebuffer.use()
            self._step.set(momentum=momentum(step))
            self._step.draw(descent=descent, y=y, p=p, step_size=self._step_size)
            p, y = following.p, following.y
        return Iterate(p, y, made + steps)

    def certify(self, p: moderngl.Texture, b: moderngl.Texture) -> Certificate:
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
            self._far = own(FarPass(stored.chain(far), "SUBTRACT_FROM_BASE"))
            self._far_dual = own(FarPass(stored.chain(maps.far_dual), "ADD_TO_BASE"))

    def run(self, y: moderngl.Texture, b: moderngl.Texture) -> tuple[moderngl.Texture, moderngl.Texture]:
        residual = self._residual.run(y, b)
        if self._far is None or self._far_dual is None:
            return residual, self._dual.run(residual)
        residual = self._far.run(y, residual)
        return residual, self._far_dual.run(residual, self._dual.run(residual))

    def release(self) -> None:
        self._owner.release()


class _Target:
    """p and y of one step, drawn together."""

    def __init__(self, context: moderngl.Context, shape: tuple[int, int]) -> None:
        self.p, self.y = float_texture(context, shape), float_texture(context, shape)
        self.framebuffer = context.framebuffer([self.p, self.y])
        self._context = context

    def release(self) -> None:
        self._context.detect_framebuffer(0).use()  # see Pass.release
        for resource in (self.framebuffer, self.p, self.y):
            resource.release()


class _Certifier:
    """The gap and the squared error, summed over the picture and read back."""

    def __init__(self, context: moderngl.Context, projector: tuple[int, int], mask: NDArray[np.bool_]) -> None:
        camera = mask.shape[0], mask.shape[1]
        self._owner = Owner()
        own = self._owner.own
        self._gap = own(Pass(context, "gap.frag", float_texture(context, projector)))
        self._squared = own(Pass(context, "squared_error.frag", float_texture(context, camera)))
        self._mask = own(integer_texture(context, mask.astype(np.uint32)))
        self._sums = own(_Sum(context, projector)), own(_Sum(context, camera))

    def run(self, residual: moderngl.Texture, descent: moderngl.Texture, p: moderngl.Texture) -> Certificate:
        gap = self._sums[0].run(self._gap.run(descent=descent, p=p))
        squared = self._sums[1].run(self._squared.run(residual=residual, mask=self._mask))
        return Certificate(_one_pixel(squared), _one_pixel(gap))

    def release(self) -> None:
        self._owner.release()


class _Sum:
    """A picture summed to one pixel, block by block."""

    def __init__(self, context: moderngl.Context, shape: tuple[int, int]) -> None:
        self._passes: list[Pass] = []
        while shape != (1, 1):
            shape = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
            self._passes.append(Pass(context, "block_sum.frag", float_texture(context, shape), {"SIDE": BLOCK}))

    def run(self, picture: moderngl.Texture) -> moderngl.Texture:
        for level in self._passes:
            picture = level.run(source=picture)
        return picture

    def release(self) -> None:
        for level in self._passes:
            level.release()


def _one_pixel(texture: moderngl.Texture) -> NDArray[np.float64]:
    return np.frombuffer(texture.read(), np.float32)[:3].astype(np.float64)
