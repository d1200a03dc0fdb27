"""make bench: costs of all parts on this machine, compared with scipy or numpy in the same run.

Prints seconds (or milliseconds per frame) and ratios; no test depends on them. `--only NAME` runs one row.
"""

import argparse
import os
import platform
import time
from collections.abc import Callable, Iterable

from tests.bench import acquisition, budgets, change, frames, hdr, maps, show, sizes, solvers, start, words

ROWS: dict[str, Callable[[], Iterable[object]]] = {
    "shader": frames.shader,
    "refined": frames.refined,
    "words": words.words,
    "frames": frames.frames,
    "show": show.show,
    "start": start.start,
    "change": change.change,
    "budget": budgets.budgets,
    "focus": solvers.focus_experiment,
    "box": solvers.box,
    "nnls": solvers.non_negative,
    "decomposed": maps.map_decomposed,
    "windowed": maps.map_windowed,
    "default": sizes.default_build,
    "hdr": hdr.radiance_maps,
    "schedule": acquisition.schedule,
    "picture": acquisition.picture,
    "capture": acquisition.capture,
    "acquisition": acquisition.whole,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("--only", choices=ROWS, action="append", help="run this row; may be given several times")
    names = parser.parse_args().only or list(ROWS)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name in names:
        start = time.perf_counter()
        print(f"\n{name}: {(ROWS[name].__doc__ or '').splitlines()[0]}")
        for line in ROWS[name]():
            print(line, flush=True)
        print(f"  ({time.perf_counter() - start:.0f} s in all)")


if __name__ == "__main__":
    main()
