"""Where refinement starts: the drive that the first step of a frame improves (`--start`)."""

from collections.abc import Callable
from typing import Protocol, TypeAlias

import moderngl
import numpy as np

from player.gl.passes import Owner, Pass, float_texture, picture_texture
from player.gl.paths import Product, StoredMap
from player.refinement import GREY

Correct: TypeAlias = Callable[[moderngl.Texture], moderngl.Texture]


class Start(Protocol):
    def advance(self, *, cut: bool) -> None:
        """A new frame comes; cut: it has nothing to do with the one before."""

    def run(self, b: moderngl.Texture) -> moderngl.Texture:
        """The drive to start from, 0..1; the same for one frame however often it is drawn."""

    def keep(self, drive: moderngl.Texture) -> None:
        """Take what refinement made of it."""

    def release(self) -> None: ...


class MapStart:
    """clamp(T⁺ b): the thesis' method.  correct : b -> that."""

    def __init__(self, correct: Correct) -> None:
        self._correct = correct

    def advance(self, *, cut: bool) -> None:
        """Nothing is carried over."""

    def run(self, b: moderngl.Texture) -> moderngl.Texture:
        return self._correct(b)

    def keep(self, drive: moderngl.Texture) -> None:
        """Nothing is carried over."""

    def release(self) -> None:
        """Nothing is held."""


class PreviousStart:
    """clamp(T⁺ b + k), k being what refinement changed in the frame before, its drive less its T⁺ b; 0 after a cut.

    correct : b -> T⁺ b, not clamped.
    """

    def __init__(self, context: moderngl.Context, shape: tuple[int, int], correct: Correct) -> None:
        self._correct, self._owner = correct, Owner()
        own = self._owner.own
        self._start = own(Pass(context, "combine.frag", float_texture(context, shape), {"CLAMP": None}, factor=1.0))
        self._before, self._now = (
            own(Pass(context, "combine.frag", float_texture(context, shape), factor=-1.0)) for _ in range(2)
        )
        self._kept = False

    def advance(self, *, cut: bool) -> None:
        self._before, self._now = self._now, self._before
        if cut or not self._kept:
            self._before.clear()
        self._kept = False

    def run(self, b: moderngl.Texture) -> moderngl.Texture:
        self._map = self._correct(b)
        return self._start.run(first=self._map, second=self._before.target)

    def keep(self, drive: moderngl.Texture) -> None:
        self._now.run(first=drive, second=self._map)
        self._kept = True

    def release(self) -> None:
        self._owner.release()


class DirectStart(MapStart):
    """Direct mapping: each projector pixel asks the camera pixel that it lights most."""

    def __init__(self, direct: StoredMap) -> None:
        self._product: Product = direct.product("CLAMP")
        super().__init__(self._product.run)

    def release(self) -> None:
        self._product.release()


class GreyStart(MapStart):
    """The same grey everywhere."""

    def __init__(self, context: moderngl.Context, shape: tuple[int, int]) -> None:
        self._grey = picture_texture(context, np.full((*shape, 3), GREY, np.float32))
        super().__init__(lambda b: self._grey)

    def release(self) -> None:
        self._grey.release()
