"""Under which conditions the product is tried: one fault alone, or what a home has all at once."""

from dataclasses import dataclass, field, replace
from typing import Any

from tests.rig.projector import Projector
from tests.rig.rig import Devices
from tests.rig.sensor import Sensor

SRGB = Projector(gammas=None)


@dataclass(frozen=True)
class Condition:
    """devices : during the acquisition.  given : what of the projector's response the acquisition is told.

    given : "table" (measured by hand), "srgb", or "" (nothing: the documented defaults).  later : what has changed when
    the picture is shown.
    """

    name: str
    says: str
    devices: Devices = field(default_factory=Devices)
    given: str = "table"
    later: tuple[tuple[str, Any], ...] = ()

    @property
    def now(self) -> Devices:
        """The devices when the picture is shown."""
        return replace(self.devices, **dict(self.later))

    @property
    def acquisition(self) -> "Condition":
        """The same for conditions that can share a calibration."""
        return replace(self, name="", says="", later=())


_NAMED = (
    Condition("quiet", "as known, without noise", Devices(sensor=Sensor(full_well=0.0))),
    Condition("known", "no crosstalk, response given, 20 000 electrons"),
    Condition("srgb", "as known, a projector of sRGB's curve", Devices(projector=SRGB), given="srgb"),
    Condition("believed", "no crosstalk, gamma 2.1/2.2/2.35, but sRGB given", given="srgb"),
    Condition("response", "no crosstalk, gamma 2.1/2.2/2.35, nothing given", given=""),
    Condition("crosstalk", "12 % crosstalk, response given", Devices("12 %")),
    Condition("home", "12 % crosstalk, gamma 2.1/2.2/2.35, nothing given", Devices("12 %"), given=""),
    Condition("led", "LED primaries, a camera's sensitivities, response given", Devices("led")),
    Condition("wheel", "a colour wheel's primaries, response given", Devices("wheel")),
    Condition("segment", "as known, a white segment of 0.4", Devices(projector=Projector(white_segment=0.4))),
    Condition("drift", "as known, then the projector's picture has moved by a pixel", later=(("shift", (0.8, 0.6)),)),
    Condition("lamp", "as known, then the lamp gives nine tenths", later=(("projector", Projector(lamp=0.9)),)),
    Condition("daylight", "as known, then there is three times the room light", later=(("room_light", 0.03),)),
)
CONDITIONS = {condition.name: condition for condition in _NAMED}
DEFAULT = "known", "response", "crosstalk", "home", "led", "wheel", "drift"
QUICK = "known", "home"
