"""What both backends offer: a frame goes in, a view of it comes out (gl/renderer.py, cpu_renderer.py)."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.adjustments import Adjustments
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.refinement import Certificate
from counterlight.video import Frame, PixelFormat

PATHS = ("auto", "fragment", "compute")
LONG_BYTES, SHORT_BYTES = 16, 8  # an entry: weights of 32 bits and an index, or of 16 bits and an offset


@dataclass(frozen=True)
class PathReport:
    """How a renderer multiplies with the room's maps.

    name : "fragment", "compute" or "cpu".  entry_bytes : of an entry of the correction map.
    fragment_ms, compute_ms : of a frame's products, measured at the start; None if that was not asked for.
    """

    name: str
    entry_bytes: int
    fragment_ms: float | None = None
    compute_ms: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Milliseconds to the microsecond."""
        shown = {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(self).items()}
        return {key: value for key, value in shown.items() if value is not None}

    def __str__(self) -> str:
        measured = ""
        if self.fragment_ms is not None and self.compute_ms is not None:
            measured = f"; fragment {self.fragment_ms:.2f} ms, compute {self.compute_ms:.2f} ms"
        return f"{self.name}, {self.entry_bytes} bytes an entry{measured}"


class Renderer(Protocol):
    """open, then upload and render as often as you like, then read what is needed; release at the end."""

    @property
    def path(self) -> PathReport:
        """How it multiplies."""

    def open(self, pixels: PixelFormat) -> None:
        """Prepare for frames of one format; raises InputError if they do not suit the room."""

    def adjust(self, adjustments: Adjustments) -> None:
        """Take over what the viewer changed, from the next render on; stays when another medium is opened.

        Something used for the first time is built here, so that a frame afterwards allocates nothing.
        """

    def upload(self, frame: Frame) -> None:
        """Take a frame's planes; the frame may be released afterwards."""

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        """Compute a view of the uploaded frame, one of VIEWS.

        split shows the camera's view without | with compensation, error how far it is from what was asked, impossible
        what no picture can reach (player/views.py). A test card has no error: error shows the camera's view of it.
        steps : of refinement, if the room has its maps; 0 is clamp(T⁺ b), the thesis' method.
        """

    def encoded(self) -> NDArray[np.uint8]:
        """The rendered view as 8-bit code values: the projector's response, or sRGB with white = 1 for the camera."""

    def linear(self) -> NDArray[np.float32]:
        """The rendered view in linear light: drive 0..1, or camera radiance."""

    def desired(self) -> NDArray[np.float32]:
        """The camera radiance that is asked for, as adapted and placed, (camera height, camera width, 3)."""

    def certificate(self) -> Certificate | None:
        """How far the drive of the rendered view can be from the best one; None without compensation or its maps.

        Costs as much as a step of refinement.
        """

    def finish(self) -> None:
        """Wait until everything asked for has been computed."""

    def release(self) -> None:
        """Give back what the renderer holds."""


def check_radiance_size(pixels: PixelFormat, calibration: Calibration) -> None:
    """An OpenEXR picture is the camera's radiance as it is: InputError unless it has the camera's size."""
    camera = calibration.camera
    if pixels.layout == "radiance" and (pixels.height, pixels.width) != camera.shape:
        raise InputError(
            f"an OpenEXR picture of {pixels.width}x{pixels.height} pixels, the camera has "
            f"{camera.width}x{camera.height}: it is taken as radiance pixel by pixel, so resize it or save it as PNG"
        )
