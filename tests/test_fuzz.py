"""The campaigns of tests/fuzz detect readers, commands and programs that are faulty on purpose."""

import json
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests import test_solve
from tests.faults import Run, Runner
from tests.faulty_reader import DEEDS, SEED, Faulty
from tests.fuzz.__main__ import KINDS, main
from tests.fuzz.bench import KILLED, Bench, Blow
from tests.fuzz.calls import Rules, calls_of, watched
from tests.fuzz.names import Ground, draw_name
from tests.fuzz.solvers import PROPERTIES, Solvers
from tests.fuzz.tables import Tables
from tests.fuzz.tally import CRASHED, LEFT, READ, WRONG, Plan
from tests.one_channel import Found


def test_every_kind_of_fault_of_a_reader_is_caught(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tally = Faulty().run(Plan(SEED, len(DEEDS), tmp_path, tmp_path / "evidence"))
    expected = [verdict for _, verdict in DEEDS]
    assert {verdict: tally.verdicts[verdict] for verdict in set(expected)} == {
        verdict: expected.count(verdict) for verdict in set(expected)
    }
    assert [finding["index"] for finding in tally.findings] == [2, 3, 4, 5, 6, 7]
    finding = json.loads((tmp_path / "evidence" / "faulty-7-4" / "finding.json").read_text())
    assert finding["again"] == "python -m tests.fuzz faulty --seed 7 --only 4"
    kept = (tmp_path / "evidence" / "faulty-7-4" / "input").read_bytes()
    assert kept == Plan(SEED, 1, tmp_path, tmp_path).rng("faulty", 4).bytes(4)
    assert tally.line().split()[:3] == ["faulty", "9", "tried"]
    assert capsys.readouterr().err.count("--only") == 6


def test_a_seed_gives_the_same_inputs(tmp_path: Path) -> None:
    plan, ground = Plan(3, 9, tmp_path, tmp_path), Ground(tmp_path, "127.0.0.1:9")
    tables = Tables()
    tables.open(tmp_path)
    for draw in (lambda rng: dict(tables.draw(rng).files), lambda rng: draw_name(ground, rng, 0)):
        first, again = ([draw(plan.rng("x", index)) for index in plan.indices()] for _ in range(2))
        assert first == again
        assert len({str(drawn) for drawn in first}) > 5


def test_a_solver_that_finds_nothing_is_wrong(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plan = Plan(SEED, 3 * len(PROPERTIES), tmp_path, tmp_path)
    assert Solvers().run(plan).verdicts == {READ: plan.count}
    monkeypatch.setattr(test_solve, "solve", lambda _, system: Found(np.zeros(system.shape[1]), ()))
    wrong = {finding["index"] % len(PROPERTIES) for finding in Solvers().run(plan).findings}
    assert wrong == {0, 1, 3, 4, 5}  # number 2 is true of any drive


DOES = {
    "writes": "open('{out}/new', 'w')",
    "reads": "open('{out}/secret').read()",
    "runs": "import subprocess; subprocess.run(['/bin/true'])",
    "calls": "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('127.0.0.1', 9))",
}


def test_the_watch_sees_what_a_program_does(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    for folder in (inside, outside):
        folder.mkdir()
        (folder / "secret").write_text("x")
    (inside / "link").symlink_to(outside / "secret")

    def broken(code: str, rules: Rules) -> list[str]:
        subprocess.run(watched([sys.executable, "-S", "-c", code], tmp_path / "log"), check=True, cwd=inside)
        return rules.broken_by(calls_of(tmp_path / "log"))

    nothing = Rules(frozenset(), (inside,), tmp_path / "scratch")
    broken("pass", nothing)
    rules = Rules(frozenset(calls_of(tmp_path / "log")), nothing.roots, nothing.scratch)
    assert broken("open('secret').read()", rules) == []
    for kind, code in DOES.items():
        found = broken(code.format(out=outside), rules)
        assert [line for line in found if line.startswith(kind)], (kind, found)
    assert broken("open('link').read()", rules) == [f"reads {outside}/secret"]
    assert broken("open('secret', 'a')", rules) == [f"writes {inside}/secret"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with Runner() as runner:
        yield Bench(runner, tmp_path_factory.mktemp("bench"), ["fit"])


STRUCK = {
    "whole": (lambda out: None, READ),
    "half": (lambda out: (out / "r.toml").write_text("response ="), WRONG),
    "lost": (lambda out: (out / "o.png").unlink(), WRONG),
    "half a room": (lambda out: (out / "room" / "mask.png").unlink(), WRONG),
    "frames of two": (lambda out: (out / "f00.png").write_text("new"), WRONG),
    "debris": (lambda out: (out / ".x.counterlight-partial").mkdir(), LEFT),
}


@pytest.mark.parametrize("kind", STRUCK)
def test_the_bench_sees_what_a_struck_command_does(kind: str, bench: Bench) -> None:
    deed, verdict = STRUCK[kind]

    def act(out: Path) -> Run:
        deed(out)
        return Run(0, 0, 130, "")

    assert bench.trial("fit", Blow(kind, act, (130,), resumed=False)).verdict == verdict
    if kind == "whole":
        assert bench.trial("fit", Blow("unexpected end", act, (0, KILLED))).verdict == CRASHED
        assert bench.trial("fit", Blow("not struck", partial(bench.run, "fit"), (0,))).verdict == READ


def test_the_command_lists_the_campaigns_and_refuses_others(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    listed = capsys.readouterr().out
    assert all(f"  {kind.name}" in listed and kind.purpose in listed for kind in KINDS)
    with pytest.raises(SystemExit, match="2"):
        main(["nothing"])
