"""A row map or a map in words on the GPU: what the fragment and the compute shaders share."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Generic, TypeVar

import moderngl

from counterlight.maps.row_map import RowMap
from counterlight.maps.word_map import WordMap
from counterlight.pipeline.device import Operation, Owner

Packed = TypeVar("Packed", RowMap, WordMap)


class GpuMap(ABC, Generic[Packed]):
    """A map on the GPU; several passes may share it."""

    def __init__(self, context: moderngl.Context, packed: Packed) -> None:
        self.context, self._owner = context, Owner()
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.defines: dict[str, int | None] = {"SOURCE_WIDTH": packed.source_shape[1]}
        self.uniforms: dict[str, float] = {}
        if isinstance(packed, WordMap):
            self.uniforms["scale"] = packed.scale
            self.defines |= {} if packed.colours is None else {"COLOURED": None}
        try:
            self._upload(packed)
        except BaseException:
            self.release()
            raise

    def product(self, combine: str = "") -> Operation:
        """Return target = Σ weights · source, combined with a base as shaders/product.glsl says.

        combine : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "CLAMP", or, for words of T,
            "WEIGHED_RESIDUAL".
        """
        return self._pass(self.defines | ({combine: None} if combine else {}))

    def release(self) -> None:
        self._owner.release()

    @abstractmethod
    def _upload(self, packed: Packed) -> None: ...

    @abstractmethod
    def _pass(self, defines: Mapping[str, int | None]) -> Operation: ...
