"""Makes small copies of a rendered picture on its device, for remote viewers."""

from typing import Generic

from counterlight.passes.certificate import BlockSum
from counterlight.passes.drawing import Picture
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.response import Response

LONGEST = 480  # most pixels of the longer side


class SmallPicture(Owning, Generic[Picture]):
    """Means of blocks of linear light, as sRGB codes. Pixels left over at the right and lower edge are cut off.

    shape : (height, width) of the pictures.
    white : light of code 255.
    """

    def __init__(self, device: Device[Picture], shape: tuple[int, int], white: float) -> None:
        self._side = side = -(-max(shape) // LONGEST)
        small = max(1, shape[0] // side), max(1, shape[1] // side)
        self._owner = Owner()
        own = self._owner.own
        with self._owner:
            self._sums = own(device.canvas(small))
            self._encoder = own(device.encoder(small, Response("srgb").over(small), white * side**2, "none"))

    def run(self, light: Picture) -> Picture:
        return self._encoder.run(self._sums.draw(BlockSum(light, self._side)), 0)
