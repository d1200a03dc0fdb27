"""A pass: pictures and numbers in, one picture out. Backends draw passes into canvases.

A pass is a frozen dataclass whose fields are its shader's inputs, by name. A picture is a texture; a number or tuple is
a uniform. A field that is True, and an optional picture or group that is given, defines its name in capitals. An
optional number defines nothing.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Picture = TypeVar("Picture")  # a picture as its backend holds it: a texture or an array
Array: TypeAlias = NDArray[np.float32]  # a picture of the CPU backend: (height, width, channels), contiguous
Numbers: TypeAlias = NDArray[np.floating] | tuple[float, ...]
NOTHING = np.zeros((0, 0, 0), np.float32)  # stands for a missing picture in the arguments of a kernel
CHANNELS = 3


@dataclass(frozen=True, eq=False)
class Draw(Generic[Picture]):
    """One draw of a fragment shader.

    shader : name of the GLSL file.
    defines : defines that every draw has.
    channels : channels of the drawn picture.
    """

    shader: ClassVar[str]
    defines: ClassVar[Mapping[str, int | None]] = {}
    channels: ClassVar[int] = CHANNELS


@dataclass(frozen=True, eq=False)
class Pass(Draw[Picture], ABC):
    """A draw of one picture."""

    @abstractmethod
    def fill(self: "Pass[Array]", out: Array) -> None:
        """Compute the picture on the processor: the CPU function."""


@dataclass(frozen=True, eq=False)
class Rows(Generic[Picture]):
    """The rows of a matrix per pixel, (height, width, 3) each; see counterlight.maps.mixing."""

    row_red: Picture
    row_green: Picture
    row_blue: Picture


class Canvas(Protocol[Picture]):
    """A picture that passes are drawn into."""

    @property
    def picture(self) -> Picture: ...

    def draw(self, made: Pass[Picture]) -> Picture:
        """Draw a pass; returns the canvas' picture, which is valid until the next draw."""

    def clear(self) -> None:
        """Make the picture black."""

    def release(self) -> None: ...


@cache
def _optional(kind: type) -> dict[str, bool]:
    """Return a dataclass' field names, and whether each may be left out."""
    return {each.name: each.default is not MISSING for each in fields(kind)}


def inputs_of(made: Any) -> Iterator[tuple[str, Any, bool]]:
    """Yield name, value and optionality of every input that is given; groups come first, followed by their inputs."""
    for name, optional in _optional(made.__class__).items():
        value = getattr(made, name)
        if value is None or value is False:
            continue
        yield name, value, optional
        if hasattr(value, "__dataclass_fields__"):
            yield from inputs_of(value)


def flat(picture: Array) -> Array:
    """View as (rows, values)."""
    return picture.reshape(picture.shape[0], -1)


def given(picture: Array | None) -> Array:
    """Return the picture for a kernel; an empty array stands for no picture."""
    return NOTHING if picture is None else picture
