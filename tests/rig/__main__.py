"""python -m tests.rig: quality of the product in rooms that its own simulator did not make.

Each room is acquired, built and shown by the documented commands, and judged by an independent camera. All of it
is simulated: see docs/rig.md for what the columns mean.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from threadpoolctl import threadpool_limits

from tests.rig.animation import MOMENTS, animate
from tests.rig.coverage import coverage
from tests.rig.faults import DEFAULT, FAULTS, QUICK, Fault
from tests.rig.films import FILMS
from tests.rig.live import EVENTS, HEADS, frame_times, judged, live, row_of
from tests.rig.rooms import ROOMS, Room
from tests.rig.table import aligned, markdown, text_of_csv
from tests.rig.trial import Verdict, trial
from tests.rig.watching import WatchCamera

QUICK_SCALE, LIVE_SCALE = 0.5, 2.0
JUDGED_S = 5.0, 10.0, 20.0, 30.0


def main() -> None:
    options = _parser().parse_args()
    if options.live:
        _live(options)
        return
    scale = options.scale or (QUICK_SCALE if options.quick else 1.0)
    names = options.fault or (QUICK if options.quick else DEFAULT)
    faults = [FAULTS[name] for name in names]
    start = time.monotonic()
    with ExitStack() as opened, ThreadPoolExecutor(os.cpu_count()) as pool:
        opened.enter_context(threadpool_limits(limits=1))  # the trials run in parallel
        folder = options.keep or Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="rig-")))
        for needed in (options.pictures, options.out and options.out.parent):
            if needed:
                needed.mkdir(parents=True, exist_ok=True)
        rooms = dict(zip(options.room, pool.map(lambda name: ROOMS[name](scale), options.room), strict=True))
        if options.coverage:
            tried = [(room, fault, folder / f"{room.name}-{fault.name}") for room in rooms.values() for fault in faults]
            print(aligned(list(pool.map(lambda each: coverage(*each), tried))))
            print(f"\nsimulated, scale {scale:g}, {time.monotonic() - start:.0f} s")
            return
        jobs = [(room, group) for room in rooms.values() for group in _sharing(faults)]

        def judged(job: tuple[Room, list[Fault]]) -> list[Verdict]:
            room, group = job
            place = folder / f"{room.name}-{group[0].name}"
            place.mkdir(parents=True)
            found = list(trial(room, group, place, options.steps, options.pictures, options.colour))
            print(f"{room.name}: {', '.join(each.name for each in group)}", file=sys.stderr, flush=True)
            return found

        verdicts = [verdict for found in pool.map(judged, jobs) for verdict in found]
    verdicts.sort(key=lambda each: (options.room.index(each.room), list(names).index(each.fault)))
    if options.out:
        options.out.write_text(text_of_csv(verdicts))
    print(markdown(verdicts))
    print(f"\nsimulated, scale {scale:g}, {time.monotonic() - start:.0f} s")


def _live(options: argparse.Namespace) -> None:
    with ExitStack() as opened:
        folder = options.keep or Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="rig-")))
        for room in options.room:
            if not options.animation:
                print(f"\n{room}\n\n| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}", flush=True)
            for film in options.film:
                for event in options.event:
                    after_s = options.after or (MOMENTS if options.animation else JUDGED_S)
                    times = {"warm_s": options.warm, "after_s": after_s}
                    camera = WatchCamera(period_s=1 / options.captures)
                    scale = options.scale or LIVE_SCALE
                    show = live(folder, room, film, event, scale=scale, camera=camera, watch=options.watch, **times)
                    if options.animation:
                        animate(show, options.animation)
                    else:
                        for moment in judged(show):
                            print(row_of(EVENTS[event].says, film, moment), flush=True)
                        print(frame_times(show), file=sys.stderr, flush=True)


def _sharing(faults: Sequence[Fault]) -> list[list[Fault]]:
    """Group faults by the calibration that they need."""
    groups: dict[Fault, list[Fault]] = {}
    for fault in faults:
        groups.setdefault(fault.acquisition, []).append(fault)
    return list(groups.values())


def _parser() -> argparse.ArgumentParser:
    described = "\n".join(f"  {each.name:10} {each.says}" for each in FAULTS.values())
    parser = argparse.ArgumentParser(
        "python -m tests.rig",
        description=f"{__doc__}\nfaults:\n{described}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--room", nargs="+", choices=ROOMS, default=list(ROOMS), help="try these rooms (default all)")
    parser.add_argument("--fault", nargs="+", choices=FAULTS, metavar="NAME", help=f"default {' '.join(DEFAULT)}")
    parser.add_argument("--quick", action="store_true", help=f"{' '.join(QUICK)}, at scale {QUICK_SCALE:g}")
    parser.add_argument("--scale", type=float, help="scale: 1 has a camera of 160x120, a projector of 96x72")
    parser.add_argument(
        "--steps", type=lambda text: [int(word) for word in text.split(",")], default=[0, 4, 16, 64], metavar="N,N…",
        help="try these steps of refinement besides the default (0,4,16,64)",
    )  # fmt: skip
    parser.add_argument("--colour", nargs="+", default=[""], metavar="TIER", help="build with these values of --colour")
    parser.add_argument("--out", type=Path, metavar="FILE.csv", help="write the figures of every picture here")
    parser.add_argument(
        "--coverage", action="store_true", help="count captured pixels inside the 90 %% interval instead"
    )
    parser.add_argument("--live", action="store_true", help="watch a playing window in real time (docs/watch.md)")
    parser.add_argument("--event", nargs="+", choices=EVENTS, default=["drift"], help="event of --live (default drift)")
    parser.add_argument("--film", nargs="+", choices=FILMS, default=["clip"], help="film of --live (default clip)")
    parser.add_argument("--warm", type=float, default=30.0, metavar="S", help="seconds of film before the event (30)")
    parser.add_argument(
        "--after", type=lambda text: [float(word) for word in text.split(",")], metavar="S,S…",
        help="judge so many seconds after the event (5,10,20,30; --animation: five times two thirds of a second)",
    )  # fmt: skip
    parser.add_argument(
        "--animation", type=Path, metavar="FILE.webp", help="draw these moments instead of judging them"
    )
    parser.add_argument("--no-watch", dest="watch", action="store_false", help="play without a watcher, for --live")
    parser.add_argument("--captures", type=float, default=5.0, metavar="N", help="captures per second, for --live (5)")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write sheets of the audience's view here")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep rooms, patterns and captures here")
    return parser


if __name__ == "__main__":
    main()
