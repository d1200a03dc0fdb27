"""Campaigns of damage against the product; a line for each, exit code 1 if one has found a fault."""

import argparse
import json
import platform
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.calibrations import Calibrations
from tests.fuzz.disks import Disks
from tests.fuzz.evening import Evening
from tests.fuzz.kills import Kills
from tests.fuzz.lines import Lines
from tests.fuzz.lists import Lists
from tests.fuzz.media import Media
from tests.fuzz.memory import Frames, Loadfiles, Reloads, Seconds, Settings
from tests.fuzz.remotes import Remotes
from tests.fuzz.signals import Signals
from tests.fuzz.solvers import Solvers
from tests.fuzz.stages import Stages
from tests.fuzz.tables import Tables
from tests.fuzz.tally import Campaign, Plan, Tally

KINDS: tuple[type[Campaign], ...] = (
    Tables,
    Calibrations,
    Media,
    Lists,
    Remotes,
    Lines,
    Evening,
    Stages,
    Kills,
    Disks,
    Signals,
    Reloads,
    Loadfiles,
    Settings,
    Seconds,
    Frames,
    Solvers,
)
FOUND = 1


def main(argv: Sequence[str] | None = None) -> int:
    options = _options(argv)
    tallies = {}
    for name in options.campaign or [kind.name for kind in KINDS]:
        tally = tallies[name] = _run(name, options)
        print(tally.line(), flush=True)
        if options.out:
            record = {"seed": options.seed, "machine": platform.platform()}
            record["campaigns"] = {name: tally.facts() for name, tally in tallies.items()}
            options.out.write_text(json.dumps(record, indent=1) + "\n")
    return FOUND if any(tally.faults for tally in tallies.values()) else 0


def _run(name: str, options: argparse.Namespace) -> Tally:
    campaign = next(kind for kind in KINDS if kind.name == name)()
    first, count = (0, options.count or campaign.count) if options.only is None else (options.only, 1)
    until = time.monotonic() + 60 * options.minutes
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-") as scratch:
        return campaign.run(Plan(options.seed, count, Path(scratch), options.evidence, first, until))


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    listed = "\n".join(f"  {kind.name:13}{kind.purpose} ({kind.count})" for kind in KINDS)
    parser = argparse.ArgumentParser(
        "python -m tests.fuzz",
        description=f"{__doc__}\n\ncampaigns, and how many trials each has:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("campaign", nargs="*", metavar="CAMPAIGN", help="campaigns to run (default: all)")
    add("--seed", type=int, default=1, metavar="N", help="seed of the random numbers (default 1)")
    add("--count", type=int, metavar="N", help="run N trials of each campaign")
    add("--only", type=int, metavar="INDEX", help="run only this trial; findings state the index")
    add("--minutes", type=float, default=float("inf"), metavar="M", help="begin no trial of a campaign after this time")
    add("--out", type=Path, metavar="FILE.json", help="write counts and findings to this file")
    add("--evidence", type=Path, default=Path("fuzz"), metavar="DIR", help="keep the inputs of faults (default fuzz)")
    options = parser.parse_args(argv)
    unknown = set(options.campaign) - {kind.name for kind in KINDS}
    if unknown:
        parser.error(f"no such campaign: {', '.join(sorted(unknown))}")
    return options


if __name__ == "__main__":
    sys.exit(main())
