"""Every command that writes, on a file system with too little space for its outputs."""

from functools import partial

from tests.faults import Runner, can_mount, small_disk
from tests.fuzz.bench import Bench, Blow
from tests.fuzz.tally import Plan, Tally
from tests.writing_commands import COMMANDS, PAGE


class Disks:
    """Each trial draws the free space: from one page to slightly more than the new files need. The old files fit."""

    name, count = "disks", 34
    purpose = "commands on a full disk: file systems of random sizes (needs the right to mount)"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        if not can_mount():
            tally.notes["not run"] = "mounting a small file system needs the right to"
            return tally
        with Runner() as runner:
            bench = Bench(runner, plan.scratch)
            for index in plan.indices():
                rng, name = plan.rng(self.name, index), sorted(COMMANDS)[index % len(COMMANDS)]
                pages = int(rng.integers(1, 1.3 * bench.clean[name].taken / PAGE + 3))
                place = partial(small_disk, size=bench.furnished + pages * PAGE)
                act = partial(bench.run, name)
                tally.add(
                    index, bench.trial(name, Blow(f"{pages} pages free", act, (0, 2), place=place, resumed=False))
                )
        return tally
