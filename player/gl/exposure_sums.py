"""Computes radiance from exposures on the GPU (thesis 3.3.2). Each pass of shaders/expose_sums.frag adds a batch."""

from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from counterlight.errors import InputError
from counterlight.gl.passes import ScreenPass, ShaderPass, float_texture
from counterlight.pipeline.device import Owner

BATCH = 16  # largest number of exposures per pass: one pass over the sums serves all of them
BATCH_BYTES = 1 << 28  # most bytes of code values that wait for a pass
TEXELS = 4095  # per row: whole pixels of three channels, four samples per texel; every OpenGL 3.3 has rows of 4096
SAMPLES = 4 * TEXELS
PAGE = 256  # code values per row of the table
SUMS = "sums", "weights", "bounds"
SPARE_UNIFORMS = 256  # uniform components left for other uniforms than the curve


class GlSums:
    """Adds pictures of one shape in float32; the counterpart of counterlight.tools.hdr.estimators.CpuSums.

    table : (levels, channels, 2). p and q of each code value (counterlight.tools.hdr.estimators); 256 or 65536 levels.
    shape : (height, width, channels).
    exponential : whether the estimate is the exponential of the quotient of the sums.
    slack : see tools/hdr/estimators.py.

    The caller owns the context. Raises InputError for pictures beyond the largest texture.
    """

    def __init__(
        self,
        context: moderngl.Context,
        table: NDArray[np.float64],
        shape: tuple[int, int, int],
        exponential: bool,
        slack: float,
    ) -> None:
        self._context, self._shape = context, shape
        self._rows = -(-shape[0] * shape[1] * shape[2] // SAMPLES)
        limit = context.info["GL_MAX_TEXTURE_SIZE"]
        if self._rows > limit:
            raise InputError(
                f"pictures of {shape[1]}x{shape[0]} exceed this GPU's textures ({limit} rows of {TEXELS} texels); "
                "merge them without --gpu"
            )
        picture_bytes = self._rows * SAMPLES * (1 if len(table) == PAGE else 2)
        self._batch = max(1, min(BATCH, limit // self._rows, BATCH_BYTES // picture_bytes))
        self._waiting: list[tuple[float, float, float, float]] = []
        self._passes = 0
        self._owner = Owner()
        with self._owner:
            self._build(table, exponential, slack)

    def _build(self, table: NDArray[np.float64], exponential: bool, slack: float) -> None:
        context, shape, pages = self._context, self._shape, len(table) // PAGE
        dtype = np.uint8 if pages == 1 else np.uint16
        self._stage = np.zeros((self._rows, SAMPLES), dtype)
        self._codes = self._owner.own(
            _texture(context, (TEXELS, self._rows * self._batch), 4, f"u{self._stage.itemsize}", None)
        )
        top = int(np.flatnonzero(table[:, 0, 1])[-1]) + 1
        sure = np.where(table[..., 1:] > 0, table, 0)
        paged = sure.reshape(pages, PAGE, -1, 2).transpose(0, 2, 1, 3).astype(np.float32, order="C")
        self._defines: dict[str, int | None] = {"ROWS": self._rows, "TOP": top, "CHANNELS": shape[2]}
        self._inputs = {"codes": self._codes}
        self._arrays: dict[str, NDArray[Any]] = {"limits": table[-1, :, 0]}
        if pages == 1 and context.info["GL_MAX_FRAGMENT_UNIFORM_COMPONENTS"] >= 4 * PAGE * shape[2] + SPARE_UNIFORMS:
            self._defines["CURVE_IN_UNIFORMS"] = None
            self._arrays["curve"] = paged
        else:
            self._inputs["table"] = self._owner.own(_texture(context, (PAGE * shape[2], pages), 2, "f4", paged))
        sums = [[self._owner.own(float_texture(context, (self._rows, TEXELS))) for _ in SUMS] for _ in range(2)]
        self._sums = [(dict(zip(SUMS, each, strict=True)), self._owner.own(context.framebuffer(each))) for each in sums]
        self._adders: dict[int, _Adder] = {}
        target = float_texture(context, (self._rows, TEXELS))
        self._estimate = self._owner.own(
            ShaderPass(
                context, "expose_estimate.frag", target, {"EXPONENTIAL": None} if exponential else {}, slack=slack
            )
        )

    def add(self, codes: NDArray[Any], coefficients: tuple[float, float, float], exposure_s: float) -> None:
        """Add an exposure. codes : (height, width, channels), unsigned."""
        self._stage.ravel()[: codes.size] = codes.ravel()
        top = len(self._waiting) * self._rows
        self._codes.write(self._stage, viewport=(0, top, TEXELS, self._rows))
        self._waiting.append((*coefficients, 1 / exposure_s))
        if len(self._waiting) == self._batch:
            self._run()

    def estimate(self) -> NDArray[np.float32]:
        """Return the radiance, (height, width, channels), and restart the sums.

        An unknown radiance is returned as −bound; the radiance is at least `bound`, and 0 means that only black was
        seen.
        """
        if self._waiting:
            self._run()
        latest, _ = self._sums[1 - self._passes % 2]
        result = np.frombuffer(self._estimate.run(**latest).read(), np.float32)
        self._passes = 0
        return result[: int(np.prod(self._shape))].reshape(self._shape)

    def _run(self) -> None:
        """Add the waiting exposures to the sums, which alternate between two sets of textures."""
        latest, _ = self._sums[1 - self._passes % 2]
        self._sums[self._passes % 2][1].use()
        add = self._adder(len(self._waiting))
        add.set(first=self._passes == 0)
        add.set_arrays(exposures=self._waiting)
        add.draw(**self._inputs, **latest)
        self._waiting.clear()
        self._passes += 1

    def _adder(self, count: int) -> "_Adder":
        """Return the pass for `count` exposures: full batches share a pass, the rest of a bracket has its own."""
        if count not in self._adders:
            adder = self._owner.own(_Adder(self._context, "expose_sums.frag", self._defines | {"BATCH": count}))
            adder.set_arrays(**self._arrays)
            self._adders[count] = adder
        return self._adders[count]

    def __enter__(self) -> "GlSums":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        self._context.detect_framebuffer(0).use()  # moderngl would bind the last framebuffer again later
        self._owner.release()


class _Adder(ScreenPass):
    """Adds a batch of exposures to the sums."""

    def set_arrays(self, **arrays: ArrayLike) -> None:
        """Set uniform arrays of floats by name."""
        for name, values in arrays.items():
            self._program[name].write(np.asarray(values, np.float32))  # type: ignore[union-attr]


def _texture(
    context: moderngl.Context, size: tuple[int, int], components: int, dtype: str, data: NDArray[Any] | None
) -> moderngl.Texture:
    texture = context.texture(size, components, data, alignment=1, dtype=dtype)
    texture.filter = moderngl.NEAREST, moderngl.NEAREST
    if context.error != "GL_NO_ERROR":  # moderngl raises nothing if memory runs out
        texture.release()
        raise InputError(f"the GPU has no memory for pictures of {size[0]}x{size[1]} texels; merge without --gpu")
    return texture
