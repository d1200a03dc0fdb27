"""Duration of a default acquisition, and the quality of its estimates: python -m tests.studies.pace.

Runs `counterlight acquire` in a shipped scene with a camera of 96x72 and a projector of 128x96 pixels. Each exposure of
the simulated camera takes a seventh of a second. The study prints the lines of the command with their times, and then
the actual exposures, minutes and megabytes. The last line shows the errors of the estimates after the first minute. An
estimate of the whole time is the time so far plus the time left. A scene takes up to ten minutes.
"""

import argparse
import io
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import redirect_stderr
from pathlib import Path
from unittest.mock import patch

from counterlight.tools import acquire_transport, simulate_transport
from counterlight.tools.acquisition import rig
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.cameras.simulated import SimulatedCamera
from counterlight.tools.acquisition.plan import Picture
from counterlight.tools.shipped import shipped_scenes

EXPOSURE_S = 1 / 7
FROM_S = 60.0
LEFT = re.compile(r"(?:about|,) (?:(?P<hours>\d+) h )?(?:(?P<minutes>\d+) min ?)?(?:(?P<seconds>\d+) s)?(?: left|,|$)")


class PacedCamera(SimulatedCamera):
    """A camera that takes a seventh of a second per exposure."""

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        end_s = time.monotonic() + EXPOSURE_S * len(self.exposures.times)
        shots = super().capture(number, picture)
        time.sleep(max(0.0, end_s - time.monotonic()))
        return shots


class TimedLines(io.StringIO):
    """Prints each line with the seconds since the start, and keeps both."""

    def __init__(self) -> None:
        super().__init__()
        self.start_s, self.lines = time.monotonic(), list[tuple[float, str]]()

    def write(self, text: str) -> int:
        for line in filter(None, text.splitlines()):
            self.lines.append((time.monotonic() - self.start_s, line))
            print(f"{self.lines[-1][0]:5.0f} s  {line}", flush=True)
        return len(text)


def seconds_left(line: str) -> float | None:
    """Returns the estimate in a line, or None."""
    found = LEFT.search(line)
    parts = [int(found[name] or 0) for name in ("hours", "minutes", "seconds")] if found else []
    return 3600.0 * parts[0] + 60 * parts[1] + parts[2] if any(parts) else None


def acquire(room: Path, folder: Path, options: Sequence[str]) -> None:
    said = TimedLines()
    with patch.object(rig, "SimulatedCamera", PacedCamera), redirect_stderr(said):
        code = acquire_transport.main(["--camera", f"simulated:{room}", "-o", f"{folder / 'room'}", *options])
    end_s = time.monotonic() - said.start_s
    captures = list((folder / "room.captures").rglob("*.png"))
    size = sum(path.stat().st_size for path in captures)
    print(f"exit code {code}: {len(captures)} exposures, {end_s / 60:.1f} minutes, {size / 1e6:.0f} MB")
    estimates = [(at, left) for at, line in said.lines if (left := seconds_left(line)) is not None]
    off = [(at + left) / end_s - 1 for at, left in estimates if at >= FROM_S]
    print(f"{len(off)} estimates after the first minute: the whole time is off by {min(off):+.0%} to {max(off):+.0%}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.pace", description=__doc__)
    parser.add_argument(
        "--scene", nargs="+", choices=shipped_scenes(), default=["corner"], help="scenes to acquire (default: corner)"
    )
    options, others = parser.parse_known_args()
    for scene in options.scene:
        print(f"\n{scene}")
        with tempfile.TemporaryDirectory() as name:
            room = Path(name) / "simulated"
            size = ["--camera", "96x72", "--projector", "128x96"]
            if simulate_transport.main([scene, *size, "-o", f"{room}"]):
                sys.exit(2)
            acquire(room, Path(name), others)


if __name__ == "__main__":
    main()
