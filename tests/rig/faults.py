"""Faults under which the product is tried: single faults, or all that a home has at once."""

from dataclasses import dataclass, field, replace
from typing import Any

from tests.rig.files import Stored
from tests.rig.lens import Lens
from tests.rig.projector import Projector
from tests.rig.rig import Devices
from tests.rig.sensor import Sensor

SRGB = Projector(gammas=None)
VIVID = Projector(vividness=(0.25, 0.2, 0.15))
FRINGES = (1.0, 0.4), (0.0, 0.0), (-0.9, -0.3)  # shifts of red, green and blue in projector pixels
SCALES = 1.003, 1.0, 0.998
HALO = 0.07  # 3.5 % of white next to a large white area
WANDERING = Sensor(wander=0.025)


@dataclass(frozen=True)
class Fault:
    """A fault of the devices or of the given data.

    devices : during the acquisition.
    given : response that the acquisition receives: "table" (measured), "srgb", or "" (none: the documented defaults).
    later : changes between the acquisition and the show.
    """

    name: str
    says: str
    devices: Devices = field(default_factory=Devices)
    given: str = "table"
    later: tuple[tuple[str, Any], ...] = ()

    @property
    def now(self) -> Devices:
        """The devices during the show."""
        return replace(self.devices, **dict(self.later))

    @property
    def acquisition(self) -> "Fault":
        """The acquisition alone; equal for faults that can share a calibration."""
        return replace(self, name="", says="", later=())


_NAMED = (
    Fault("quiet", "as known, without noise", Devices(sensor=Sensor(full_well=0.0))),
    Fault("known", "nothing but 20 000 electrons: no crosstalk, response given"),
    Fault("srgb", "as known, a projector of sRGB's curve", Devices(projector=SRGB), given="srgb"),
    Fault("believed", "no crosstalk, gamma 2.1/2.2/2.35, but sRGB given", given="srgb"),
    Fault("response", "no crosstalk, gamma 2.1/2.2/2.35, nothing given", given=""),
    Fault("crosstalk", "12 % crosstalk, response given", Devices("12 %")),
    Fault("home", "12 % crosstalk, gamma 2.1/2.2/2.35, nothing given", Devices("12 %"), given=""),
    Fault("led", "LED primaries, a camera's sensitivities, response given", Devices("led")),
    Fault("wheel", "a colour wheel's primaries, response given", Devices("wheel")),
    Fault("webcam", "as known, 8-bit JPEGs of quality 92, 4:2:0, sRGB", Devices(stored=Stored("srgb", quality=92))),
    Fault("curve", "as webcam, a vendor's S-curve after sRGB", Devices(stored=Stored("vendor", quality=92))),
    Fault("segment", "as known, a white segment of 0.4", Devices(projector=Projector(white_segment=0.4))),
    Fault("processing", "as response, saturated colours 15 to 25 % brighter", Devices(projector=VIVID), given=""),
    Fault("lateral", "as known, red and blue a pixel from green", Devices(lens=Lens(FRINGES, SCALES))),
    Fault("halo", "as known, surroundings of white rise by 3.5 %", Devices(lens=Lens(halo=HALO))),
    Fault("wander", "as known, gain of a capture's channel 2.5 % at random", Devices(sensor=WANDERING)),
    Fault(
        "unprocessed", "lateral, halo and wander together", Devices(lens=Lens(FRINGES, SCALES, HALO), sensor=WANDERING)
    ),
    Fault(
        "real",
        "processing, lateral, halo and wander together",
        Devices(projector=VIVID, lens=Lens(FRINGES, SCALES, HALO), sensor=WANDERING),
        given="",
    ),
    Fault("drift", "as known, then the projector's picture has moved by a pixel", later=(("shift", (0.8, 0.6)),)),
    Fault("lamp", "as known, then the lamp gives nine tenths", later=(("projector", Projector(lamp=0.9)),)),
    Fault("daylight", "as known, then there is three times the room light", later=(("room_light", 0.03),)),
)
FAULTS = {fault.name: fault for fault in _NAMED}
DEFAULT = "known", "crosstalk", "home", "wheel", "drift"
QUICK = "known", "home"
