"""make figures: every row names figures that its page contains, and detects a changed figure."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import moderngl
import pytest

from counterlight.gl.context import in_software
from tests.bench.frames import clock_of
from tests.figures.__main__ import CommandFailedError, checked, told, written_by
from tests.figures.cells import (
    ROUNDING,
    agree,
    columns,
    differences,
    last_digit,
    like,
    markdown,
    pattern,
    renamed,
    without,
)
from tests.figures.claims import Prose, Said, Table, said, sentence, sentences
from tests.figures.printed import SOLVED, one_picture
from tests.figures.row import Figures
from tests.figures.rows import ROWS
from tests.figures.unchecked import SENTENCES, UNCHECKED
from tests.programs import ROOT

PAGE = """
| room | fault | error, dB | ms |
|---|---|---|---|
| wall | known | 47.1 (0.3) | 12 |
| | home | **30** / 1e4 | 14 |

Words.

| other | error |
|---|---|
| 1 | 2 |

| room | fault | error, dB | ms |
|---|---|---|---|
| wall | known | | 6 |
"""


PROSE = [row for row in ROWS if isinstance(row, Prose)]
SAID = [row for row in PROSE if isinstance(row, Said)]


def page(row: Figures) -> str:
    return (ROOT / row.page).read_text(encoding="utf-8")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_points_to_figures_that_its_page_has(row: Figures) -> None:
    stated = row.stated(page(row))
    assert set(stated) == set(row.words) if isinstance(row, Prose) else len(stated) > 2
    assert any(re.search(r"\d", cell) for cell in stated.values())
    assert isinstance(row, Prose) or re.search("scaling|bench", row.name) or not all(map(row.times, stated))


@pytest.mark.parametrize("row", PROSE, ids=lambda row: row.name)
def test_a_sentence_stands_once_on_its_page(row: Prose) -> None:
    line = " ".join(page(row).split())
    assert {words: len(re.findall(sentence(words), line)) for words in row.words} == dict.fromkeys(row.words, 1)
    assert all("{}" in words for words in row.words)


@pytest.mark.parametrize("row", SAID, ids=lambda row: row.name)
def test_a_sentence_says_what_a_table_says(row: Said) -> None:
    """The sentence equals the table to the last digit, and differs from a changed table."""
    stated, text = row.stated(page(row)), page(row.of)
    assert differences(stated, row.follow(text), row.times, units=ROUNDING, share=0) == []
    changed = re.sub(r"(?m)^\|.*", lambda line: re.sub(r"\d", _other, line[0]), text)
    assert {each.name for each in differences(stated, row.follow(changed), row.times, ROUNDING, 0)} == set(row.words)


def _other(digit: re.Match[str]) -> str:
    return str((int(digit[0]) + 5) % 10)


def tables_of_figures() -> Iterator[tuple[str, str, str]]:
    """Yield page, header, and the page with other digits in one table, for tables of at least a third numbers."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = path.read_text(encoding="utf-8")
        for block in re.finditer(r"(?:^\|.*\n?)+", text, re.MULTILINE):
            head, rule, *body = block[0].splitlines()
            cells = [cell.strip(" *`~<>+−-") for line in body for cell in line.strip("| ").split(" | ")[1:]]
            if 3 * sum(bool(re.fullmatch(r"\d.{0,40}", cell)) for cell in cells) >= max(len(cells), 1):
                other = [re.sub(r"\d", _other, line) for line in body]
                changed = "\n".join([head, rule, *other, ""])
                yield str(path.relative_to(ROOT)), head, text[: block.start()] + changed + text[block.end() :]


def test_every_table_of_figures_is_checked_or_listed_with_a_reason() -> None:
    unlisted, checked = [], []
    listed = {(page, beginning) for page, beginning, _ in UNCHECKED}
    for name, head, changed in tables_of_figures():
        text = (ROOT / name).read_text(encoding="utf-8")
        known = {each for each in listed if each[0] == name and head.startswith(each[1])}
        read = any(row.stated(text) != row.stated(changed) for row in ROWS if row.page == name)
        unlisted += [] if read or known else [(name, head)]
        checked += list(known) if read else []
        listed -= set() if read else known
    assert unlisted == [], "give them a row of tests/figures/rows.py, or a reason in unchecked.py"
    assert checked == [], "a row checks them: take them off unchecked.py"
    assert listed == set(), "no page has these any more: take them off unchecked.py"


def test_sentences_that_nothing_checks_are_on_their_pages() -> None:
    lines = {name: " ".join((ROOT / name).read_text(encoding="utf-8").split()) for name, _, _ in SENTENCES}
    assert [(name, words) for name, words, _ in SENTENCES if lines[name].count(words) != 1] == []


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_names_commands_that_there_are(row: Figures) -> None:
    verbs = {"simulate", "build", "play", "compensate", "study", "example", "acquire", "verify"}
    for command in row.commands:
        program, *words = command.split()
        if program == "python":
            module = ROOT / words[1].replace(".", "/")
            assert module.with_suffix(".py").exists() or (module / "__main__.py").exists()
        else:
            assert words[0] in verbs
    assert row.minutes > 0


def test_tables_are_read_by_their_headers_and_blank_labels_repeat_what_is_above() -> None:
    cells = markdown("room | fault")(PAGE)
    assert cells["1: wall | known, error, dB"] == "47.1 (0.3)"
    assert cells["1: wall | home, ms"] == "14"
    assert cells["2: wall, ms"] == "6"
    assert cells["2: wall, error, dB"] == ""
    assert not any("other" in name for name in cells)


def test_rows_are_called_by_the_cells_that_tell_them_apart() -> None:
    """A figure after a name is compared, and does not become part of the name."""
    table = "| case | error | way |\n|---|---|---|\n| wall | 1.7 | a |\n| target | 20 | a |\n"
    assert markdown("case")(table)["1: target, error"] == "20"
    again = markdown("case")(table.replace("20", "21"))
    assert [each.name for each in differences(markdown("case")(table), again, lambda _: False, units=0)] == []
    worse = markdown("case")(table.replace("20", "30"))
    assert [each.name for each in differences(markdown("case")(table), worse, lambda _: False)] == ["1: target, error"]
    assert "1: wall | 1.7 | b, way" in markdown("case")(table.replace("target | 20 | a", "wall | 1.7 | b"))


def test_sentences_are_read_across_lines_and_follow_from_cells() -> None:
    words = "costs {} to {} dB...at {}%"
    text = "It costs 0.5\nto -1.2 dB with\n9 steps at 1,200%."
    assert sentences(words, "never {}")(text) == {words: "0.5 -1.2 1,200"}
    table = Table(markdown("room | fault")(PAGE))
    assert table("1: wall", "error, dB", 1) == [0.3, 1e4]
    assert table.one("home", "ms") == 14
    with pytest.raises(LookupError, match="no number"):
        table("corner", "ms")
    with pytest.raises(LookupError, match="several"):
        table.one("1: wall", "ms")
    of = Figures("p", ("c",), 1, markdown("room | fault"), markdown("room | fault"))
    row = said("p", of, ("it takes {} ms", lambda t: t("home", "ms")), ("no more than {}", lambda t: t("corner", "ms")))
    assert row.follow(PAGE) == {"it takes {} ms": "14"}
    assert [each.time for each in differences({"it takes {} ms": "40"}, row.follow(PAGE), row.times)] == [True]


def test_tables_in_columns_are_read_by_first_words() -> None:
    lines = "head", "solver   PSNR dB   SSIM", "none       9.62 0.2", "   a b", "   map 3 x", "map       33.36  0.8"
    text = "\n".join([*lines, "", "solver  PSNR dB  SSIM", "map  1.0  2.0"])
    read = columns("solver", {"map": ("map", 1), "`map`, cut": ("map", 2), "gone": ("svd", 1)})
    assert read(text) == {
        **{"map, solver": "map", "map, PSNR dB": "33.36", "map, SSIM": "0.8"},
        **{"`map`, cut, solver": "map", "`map`, cut, PSNR dB": "1.0", "`map`, cut, SSIM": "2.0"},
    }
    assert renamed(read, {"map, SSIM": "ssim"})(text) == {"ssim": "0.8"}


def test_what_compensate_prints_is_what_its_page_says() -> None:
    """Page and command use the same names for cells, so a command that printed the page's figures would pass."""
    row = one_picture()
    stated = row.stated(page(row))
    head = ["solver", "RMSE %", "PSNR dB", "SSIM", "CIEDE2000", "clipped %", "seconds"]
    ours = ["RMSE, % of white", "PSNR, dB", "SSIM", "CIEDE2000", "clipped, %", "seconds"]
    lines = [
        "  ".join([solver, *(stated.get(f"{label}, {column}", "0") for column in ours)])
        for label, (solver, _) in SOLVED.items()
    ]
    printed = "\n".join(["  ".join(head), *lines])
    assert differences(stated, row.found(printed), row.times) == []
    assert len(stated) > 5 * len(SOLVED)


def test_another_figure_is_found_and_rounding_is_none() -> None:
    stated = markdown("room | fault")(PAGE)
    assert differences(stated, dict(stated), lambda name: False) == []
    found = markdown("room | fault")(PAGE.replace("47.1", "43.1").replace("| 14 |", "| 40 |").replace("1e4", "2e4"))
    by_name = {each.name: each for each in differences(stated, found, lambda name: name.endswith(", ms"))}
    assert by_name.keys() == {"1: wall | known, error, dB", "1: wall | home, ms", "1: wall | home, error, dB"}
    assert by_name["1: wall | home, ms"].time
    assert "the page says 47.1 (0.3), found 43.1 (0.3)" in str(by_name["1: wall | known, error, dB"])
    [missing] = differences({"a": "1"}, {}, lambda name: False)
    assert "found nothing" in str(missing)


@pytest.mark.parametrize(
    ("stated", "found", "same"),
    [
        ("0.02", "0.03", True),  # within two units of the last digit
        ("0.02", "0.05", False),
        ("29.6", "29.9", True),  # this is within a twentieth
        ("365678", "365901", True),
        ("**20** / 1e4", "20 / 1.2e+04", True),
        ("1000", "100", False),
        ("1, 0.34", "2, 0.34", True),
        ("2959 (windowed)", "2959", False),
        ("uncut", "none", False),
        ("–", "", True),
        ("-0.00", "0.00", True),
        ("731,416", "731416", True),
        ("1,416", "1,816", False),
    ],
)
def test_cells_agree_to_what_the_page_states(stated: str, found: str, same: bool) -> None:
    assert agree(stated, found) == same


def test_times_agree_to_a_factor_of_two() -> None:
    assert like("12", "22")
    assert not like("12", "25")
    assert like("0.5; 3 ms", "0.9; 2 ms")
    assert like("0.0", "0.07")
    assert not like("0.0", "0.3")
    assert not like("0.5; 3 ms", "0.9")
    assert [last_digit(number) for number in ("3.14", "12", "1e4", "2.1e2")] == [0.01, 1, 1e4, 10]


def test_seconds_within_a_cell_are_times() -> None:
    stated = {"a": "309; 170 s; 1.33 dB", "b": "20.4 s; 29.9 ms; 1.94 dB", "c": "n.a.", "d": "16 steps"}
    again = {"a": "309; 99 s; 1.34 dB", "b": "20.4 s; 90 ms; 1.94 dB", "c": "n.a.", "d": "16 steps"}
    [slower] = differences(stated, again, lambda name: False)
    assert (slower.name, slower.time) == ("b", True)
    worse = {"a": "309; 170 s; 2.33 dB", "b": stated["b"], "c": "3 s; 4 ms; 0.1 dB", "d": "32 steps"}
    found = differences(stated, worse, lambda name: False)
    assert {(each.name, each.time) for each in found} == {("a", False), ("c", False), ("d", False)}


def test_what_a_page_keeps_from_earlier_is_not_compared() -> None:
    cells = without(markdown("room | fault"), "ms")(PAGE)
    assert "1: wall | known, error, dB" in cells
    assert not any(name.endswith(", ms") for name in cells)


def test_studies_that_draw_know_the_clock_of_their_context(gl_context: moderngl.Context) -> None:
    """The clock for software OpenGL is processor time; tests/bench and three studies once used another clock."""
    software = in_software(gl_context.info["GL_RENDERER"])
    assert clock_of(gl_context) is (time.process_time if software else time.perf_counter)


def test_a_pattern_gives_its_groups() -> None:
    assert pattern(a=r"(\d+) of (\d+)", b="x(y)")("3 of 4") == {"a": "3 4"}


def test_a_command_that_fails_leaves_its_figures_unchecked(capsys: pytest.CaptureFixture[str]) -> None:
    row = Figures("README.md", ('python -c "raise SystemExit(3)"',), 1, pattern(a="(x)"), pattern(a="(x)"))
    with pytest.raises(CommandFailedError, match="ended with exit code 3"):
        list(told(row))
    assert "stale" not in capsys.readouterr().out
    assert checked([row, row]) == (0, 1)
    assert "not checked: its command failed above" in capsys.readouterr().out


def test_what_commands_print_and_write_is_compared_with_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    """Two one-line programs, one of which writes a file, are compared with the README's first heading."""
    commands = 'python -c "print(12)"', "python -c \"open('f', 'w').write('Counterlight 7')\""
    row = Figures("README.md", commands, 1, pattern(name="# (Counterlight)"), pattern(name="(Counterlight)"), ("f",))
    assert list(told(row)) == []
    other = Figures("README.md", commands, 1, pattern(name="# (Counterlight)"), pattern(name="(1.)"), ("f",))
    assert [each.found for each in told(other)] == ["12"]
    assert "stale: name: the page says Counterlight, found 12" in capsys.readouterr().out


def test_words_of_a_first_run_do_not_cut_a_table_in_two(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(
        "print('| room | dB |\\n|---|---|\\ncompiling for this processor, once: 2 passes left\\n| wall | 1 |')"
    )
    printed = written_by((f"python {tmp_path / 'study.py'}",), ())
    assert markdown("room | dB")(printed) == {"1: wall, room": "wall", "1: wall, dB": "1"}
