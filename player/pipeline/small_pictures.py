"""Makes small copies of a rendered picture on its device, for remote viewers."""

from counterlight.pipeline.device import Device, Light, Owner
from counterlight.response import Response

LONGEST = 480  # pixels of the longer side, at most


class SmallPicture:
    """Means of blocks of linear light, as sRGB codes. Pixels left over at the right and lower edge are cut off.

    shape : (height, width) of the pictures.
    white : light of code 255.
    """

    def __init__(self, device: Device, shape: tuple[int, int], white: float) -> None:
        side = -(-max(shape) // LONGEST)
        small = max(1, shape[0] // side), max(1, shape[1] // side)
        self._owner = Owner()
        own = self._owner.own
        try:
            self._sums = own(device.make_pass("block_sum.frag", small, {"SIDE": side}))
            self._encoder = own(device.encoder(small, Response("srgb").over(small), white * side**2, "none"))
        except BaseException:
            self.release()
            raise

    def run(self, light: Light) -> Light:
        return self._encoder.run(self._sums.run(source=light), 0)

    def release(self) -> None:
        self._owner.release()
