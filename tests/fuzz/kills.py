"""Every command that writes, killed or refused (no space) at every step by which data reach the disk."""

from functools import partial

from tests.faults import KILL, REFUSE, Fault, Runner
from tests.fuzz.bench import KILLED, Bench, Blow
from tests.fuzz.tally import Plan, Tally

HOWS = (KILL, True), (KILL, False), (REFUSE, True)  # kind of fault, and whether folders can be exchanged
ENDS = {KILL: (KILLED, 0), REFUSE: (0, 2)}  # 0 occurs if the fault hits the final cleanup


class Kills:
    """A fault is injected at every step of every command in three ways, in random order.

    Then the command runs again.
    """

    name, count = "kills", 60
    purpose = "commands killed or refused at a step of their writing"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        with Runner() as runner:
            bench = Bench(runner, plan.scratch)
            steps = [(name, at + 1) for name, clean in bench.clean.items() for at in range(clean.steps)]
            strikes = [(name, at, *how) for name, at in steps for how in HOWS]
            order = plan.rng(self.name, 0).permutation(len(strikes))
            for index in plan.indices():
                if index < len(strikes):
                    name, at, how, exchange = strikes[order[index]]
                    act = partial(bench.run, name, fault=Fault(at, how, exchange=exchange))
                    words = f"{how} at {at}{'' if exchange else ', folders cannot be exchanged'}"
                    tally.add(index, bench.trial(name, Blow(words, act, ENDS[how], exchange)))
        tally.notes["of"] = f"{len(strikes)} at {len(steps)} steps"
        return tally
