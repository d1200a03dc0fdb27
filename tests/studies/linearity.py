"""Linearity of a camera from two pictures: python -m tests.studies.linearity.

In the rooms of the rig (tests/rig, docs/rig.md), cameras that store the sensor's picture in several ways capture black,
white and the two pictures of tools/acquisition/linearity.py. The study prints the bend of each camera, which is 0 % for
a linear camera, and the verdict on a given response: docs/tables/linearity.md. All of it is simulated.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.response import named_response
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.linearity import MOST_BENT, SURELY, Bend, bend_of, shown_halves
from counterlight.tools.acquisition.plan import REPEATS, Picture, Reference, codes_of, mean_of, measure_noise
from tests.rig.files import Stored
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.rig.sensor import Sensor

EXPOSURES = Exposures()


@dataclass(frozen=True)
class Trial:
    """A camera.

    response : camera response that the acquisition receives.
    """

    says: str
    stored: Stored
    sensor: Sensor = field(default_factory=Sensor)
    response: str = "linear"


FEW = replace(Sensor(), full_well=2000.0)
TRIALS = (
    Trial("linear, 14 bits", Stored(bits=16)),
    Trial("linear, 14 bits, 2 000 electrons", Stored(bits=16), FEW),
    Trial("linear, 8 bits", Stored()),
    Trial("linear, 8 bits, 2 000 electrons", Stored(), FEW),
    Trial("linear, 8 bits, JPEG 92", Stored(quality=92)),
    Trial("linear, 8 bits, JPEG 50", Stored(quality=50)),
    Trial("sRGB, 8 bits, JPEG 92, the response given", Stored("srgb", quality=92), response="srgb"),
    Trial("sRGB, 8 bits, JPEG 92", Stored("srgb", quality=92)),
    Trial("sRGB, 8 bits, PNG", Stored("srgb")),
    Trial("sRGB, 8 bits, PNG, 2 000 electrons", Stored("srgb"), FEW),
    Trial("sRGB, then an S, 8 bits, JPEG 92", Stored("srgb, then S", quality=92)),
    Trial("an S, 8 bits, PNG", Stored("S")),
    Trial("a weak S, 8 bits, JPEG 92", Stored("weak S", quality=92)),
    Trial("gamma 1.2, 8 bits, JPEG 92", Stored(1.2, quality=92)),
    Trial("gamma 1.8, 14 bits", Stored(1.8, bits=16)),
)


def measured(rig: Rig, stored: Stored, exposures: Exposures = EXPOSURES) -> Bend | None:
    """Returns the bend that the acquisition measures with the rig's camera."""
    number = 0

    def captured(pictures: Sequence[Picture]) -> list[NDArray[Any]]:
        nonlocal number
        shots = []
        for picture in pictures:
            shots.append(stored.codes(rig.photograph(codes_of(picture), number)))
            number += 1
        return shots

    shape = rig.raster
    levels = [np.zeros(shape, np.bool_)] * REPEATS, [np.ones(shape, np.bool_)] * REPEATS, shown_halves(shape)
    shots = [captured(pictures) for pictures in levels]
    black, white, halves = ([exposures.radiance([shot]).astype(np.float64) for shot in each] for each in shots)
    saturated = exposures.saturated([shots[0][0]]) | exposures.saturated([shots[1][0]])
    room = Reference(mean_of(black), mean_of(white), measure_noise(black, white), saturated, REPEATS)
    middle = len(halves) // 2
    return bend_of(room, mean_of(halves[:middle]), mean_of(halves[middle:]))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.linearity", description=__doc__)
    parser.add_argument("--room", nargs="+", choices=ROOMS, default=list(ROOMS), help="try these rooms (default all)")
    parser.add_argument(
        "--scale", type=float, default=1.0, help="scale: 1 has a camera of 160x120, a projector of 96x72"
    )
    options = parser.parse_args()
    rooms = [ROOMS[name](options.scale) for name in options.room]
    print(f"| camera | {' | '.join(options.room)} | most of a linear one | if this response is given |")
    print("|---" * (len(rooms) + 3) + "|", flush=True)
    for trial in TRIALS:
        bends = [_bend(Rig(room, Devices(sensor=trial.sensor)), trial) for room in rooms]
        most = max(MOST_BENT + SURELY * bend.deviation for bend in bends)
        verdicts = {"goes on" if bend.is_linear else "stops" for bend in bends}
        cells = [f"{100 * bend.amount:+.1f} %" for bend in bends]
        print(
            f"| {trial.says} | {' | '.join(cells)} | ± {100 * most:.1f} % | {', '.join(sorted(verdicts))} |", flush=True
        )


def _bend(rig: Rig, trial: Trial) -> Bend:
    bend = measured(rig, trial.stored, Exposures(response=named_response(trial.response)))
    assert bend is not None, trial
    return bend


if __name__ == "__main__":
    main()
