"""T's error from the camera's noise, and the cost of averaging: python -m tests.studies.noise.

In the rooms of the rig (tests/rig, docs/rig.md) the product acquires T through the rig's own camera, with 20 000 and
with 2 000 electrons. Each picture is captured once, or as often as the product chooses without a time limit. T is
compared with the rig's own T. Prints the table of docs/schemes.md. All of it is simulated.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.averaging import Aim
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.plan import MakeScheme, Picture, codes_of
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.transport.transport import Transport
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS, Room
from tests.rig.sensor import Sensor

SCHEMES: dict[str, MakeScheme] = {"hierarchical": HierarchicalScheme(), "multiplexed": MultiplexedScheme()}
WAYS = {"once": False, "by noise": True}
LINEAR = Exposures()
ANY_TIME = Aim(seconds=1e9)


class RigCamera:
    """The rig's camera with the product's camera interface."""

    name = "rig"

    def __init__(self, rig: Rig, exposures: Exposures = LINEAR) -> None:
        self._rig, self.exposures, self.raster = rig, exposures, rig.raster

    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None: ...

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        return (self._rig.devices.stored.codes(self._rig.photograph(codes_of(picture), number)),)


def noisy_rig(room: Room, electrons: float) -> Rig:
    """Returns a rig with noise as its only fault: each channel sees its own primary."""
    return Rig(room, Devices(sensor=replace(Sensor(), full_well=electrons)))


def acquired(rig: Rig, scheme: MakeScheme, *, averaged: bool) -> Acquisition:
    camera = RigCamera(rig)
    store = MemoryStore(camera.exposures, averaged=averaged)
    return acquire(camera, store, scheme, [rig.raster], None, ANY_TIME)[0]


def error_of(found: Transport, rig: Rig) -> float:
    """Returns ‖T − T₀‖ / ‖T₀‖ over all channels, column by column; T₀ is the rig's T above the black level."""
    off = whole = 0.0
    for pixel in range(rig.raster[0] * rig.raster[1]):
        drive = np.zeros((rig.raster[0] * rig.raster[1], 3))
        drive[pixel] = 1
        truth = (1 - rig.devices.projector.black) * rig.transport.apply(drive)
        off += float(np.sum((found.apply(drive) - truth) ** 2))
        whole += float(np.sum(truth**2))
    return (off / whole) ** 0.5


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.noise", description=__doc__)
    parser.add_argument("--room", nargs="+", choices=ROOMS, default=list(ROOMS), help="try these rooms (default all)")
    parser.add_argument(
        "--scheme",
        nargs="+",
        choices=SCHEMES,
        default=["hierarchical"],
        help="scheme that acquires (default hierarchical)",
    )
    parser.add_argument(
        "--electrons",
        nargs="+",
        type=float,
        default=[20000.0, 2000.0],
        help="electrons of a full pixel (default 20000 2000)",
    )
    parser.add_argument(
        "--scale", type=float, default=0.5, help="scale: 1 has a camera of 160x120, a projector of 96x72"
    )
    options = parser.parse_args()
    print("| room | electrons | scheme | captured | pictures | exposures | finest | error of T | predicted |")
    print("|---" * 9 + "|", flush=True)
    for name in options.room:
        room = ROOMS[name](options.scale)
        for electrons in options.electrons:
            rig = noisy_rig(room, electrons)
            for scheme in options.scheme:
                for way, averaged in WAYS.items():
                    with threadpool_limits(limits=1):
                        done = acquired(rig, SCHEMES[scheme], averaged=averaged)
                        error = 100 * error_of(done.measured.transport, rig)
                    chosen = done.averaged
                    cut = (f"{chosen.most}", f"{100 * chosen.error:.2f} %") if chosen else ("1", "")
                    cells = name, f"{electrons:.0f}", scheme, way, done.pictures, done.exposures, cut[0]
                    print("|", " | ".join(map(str, (*cells, f"{error:.2f} %", cut[1]))), "|", flush=True)


if __name__ == "__main__":
    main()
