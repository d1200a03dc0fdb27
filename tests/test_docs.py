"""Pages of docs/: each task is walked as a reader would, the index reaches all pages, and no link is dead."""

import os
import re
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from pythonosc.osc_message import OscMessage

from counterlight.tools.verbs import VERBS
from tests.parsers import parser_of
from tests.programs import PATIENCE_S, ROOT, command, running
from tests.web_remote import free_port

DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "calib_data" / "README.md"]
LINK = re.compile(r"\]\(([^)#:]+?)(?:#[^)]*)?\)")


def test_who_has_a_matrix_gets_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    picture = np.random.default_rng(2).integers(60, 120, (24, 32, 3)).astype(np.uint8)
    cv2.imwrite("picture.png", cv2.GaussianBlur(picture, (0, 0), 2))
    blocks = dict(re.findall(r"```(python|sh)\n(.*?)```", (DOCS / "matrix.md").read_text(), re.DOTALL))
    exec(compile(blocks["python"], "docs/matrix.md", "exec"), {})
    for line in blocks["sh"].splitlines():
        program, verb, *arguments = shlex.split(line, comments=True)
        assert program == "counterlight"
        done = command(verb, *arguments)
        assert done.returncode == 0, done.stderr
        assert verb != "import-transport" or done.stdout.endswith("; next: counterlight build room\n")
        quality = re.search(r"camera PSNR ([\d.]+) dB", done.stdout)
        # the wallpaper is invisible
        assert "--view" not in arguments or (quality and float(quality[1]) > 35), done.stdout
    assert cv2.imread("drive.png").shape == (18, 24, 3)
    assert cv2.imread("seen.png").shape == (24, 32, 3)


@contextmanager
def bridge(number: int, folder: Path, *words: object) -> Iterator[tuple[socket.socket, int]]:
    """Run a script of docs/remote.md; yield the socket that receives its messages, and its Art-Net port."""
    script = re.findall(r"```python\n(.*?)```", (DOCS / "remote.md").read_text(), re.DOTALL)[number]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.bind(("127.0.0.1", 0))
        heard.settimeout(PATIENCE_S)
        port = free_port(socket.SOCK_DGRAM)
        text = script.replace("9000", str(heard.getsockname()[1])).replace("6454", str(port))
        (folder / "bridge.py").write_text(text)
        with running(sys.executable, folder / "bridge.py", *words):
            yield heard, port


def received(heard: socket.socket) -> tuple[str, float]:
    message = OscMessage(heard.recv(1000))
    return message.address.removeprefix("/counterlight/share/"), message.params[0]


def test_a_midi_desk_commands_the_show(tmp_path: Path) -> None:
    """The desk sends a fader, the next fader as running status after a clock, a note, and a fader of channel 4."""
    os.mkfifo(tmp_path / "desk")
    with bridge(0, tmp_path, tmp_path / "desk") as (heard, _), (tmp_path / "desk").open("wb", buffering=0) as desk:
        desk.write(bytes([0xB0, 1, 127, 2, 0xF8, 0, 0x90, 1, 100, 0xC0, 5, 0xB3, 99, 3, 64, 127]))
        assert [received(heard) for _ in range(3)] == [("brightness", 1.0), ("contrast", 0.0), ("blackout", 1.0)]


def test_a_lighting_desk_commands_the_show(tmp_path: Path) -> None:
    """Changes of the universe are forwarded; other universes and other packets are not."""

    def dmx(universe: int, *levels: int) -> bytes:
        head = b"Art-Net\0" + bytes([0, 0x50, 0, 14, 0, 0]) + universe.to_bytes(2, "little")
        return head + len(levels).to_bytes(2, "big") + bytes(levels)

    with bridge(1, tmp_path) as (heard, port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as desk:
        desk.connect(("127.0.0.1", port))
        heard.setblocking(False)
        deadline = time.monotonic() + PATIENCE_S
        while True:  # until the bridge listens
            assert time.monotonic() < deadline
            with suppress(OSError):
                desk.send(dmx(0, 255, 0))
            time.sleep(0.05)
            with suppress(BlockingIOError):
                first = received(heard)
                break
        heard.settimeout(PATIENCE_S)
        assert [first, received(heard)] == [("brightness", 1.0), ("contrast", 0.0)]
        for packet in (dmx(1, 7, 7), b"Art-Poll", b"", dmx(0, 255, 51)):
            desk.send(packet)
        assert received(heard) == ("contrast", pytest.approx(0.2))


def test_every_page_is_in_the_index() -> None:
    linked = {(DOCS / target).resolve() for target in LINK.findall((DOCS / "README.md").read_text())}
    assert set(DOCS.glob("*.md")) - {DOCS / "README.md"} <= linked


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=lambda page: page.name)
def test_no_link_leads_nowhere(page: Path) -> None:
    targets = LINK.findall(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing
    if DOCS in page.parents:  # the site consists of docs/ alone
        assert all((page.parent / target).resolve().is_relative_to(DOCS) for target in targets)


def anchors(page: Path) -> set[str]:
    """Returns the anchors of a page's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#+ (.*)", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    plain = (re.sub(r"\]\([^)]*\)|[^\w\s-]", "", heading).lower() for heading in headings)
    return {re.sub(r"\s+", "-", heading.strip()) for heading in plain}


def test_no_link_leads_to_a_heading_that_is_not_there() -> None:
    missing = [
        f"{page.name}: {target}#{anchor}"
        for page in PAGES
        for target, anchor in re.findall(r"\]\(([^)#:]*)#([^)]*)\)", page.read_text())
        if anchor not in anchors(page.parent / target if target else page)
    ]
    assert missing == []


def tables(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the tables outside code blocks: number of the first line, and the lines."""
    code, lines = False, list[str]()
    for number, line in enumerate([*text.splitlines(), ""], 1):
        code ^= line.lstrip().startswith("```")
        if not code and line.lstrip().startswith("|"):
            lines.append(line.strip())
        elif lines:
            yield number - len(lines), lines
            lines = []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_are_whole(page: Path) -> None:
    """Each table has a head, a rule below it, and equal cells per row; an empty line would turn the rest into text."""
    for number, lines in tables(page.read_text()):
        where = f"{page.name}:{number}"
        assert len(lines) > 2, where
        assert re.fullmatch(r"\|(\s*:?-+:?\s*\|)+", lines[1]), where
        assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {lines[1].count("|")}, where
        assert all(line.endswith("|") for line in lines), where


@pytest.fixture(scope="module")
def defaults() -> dict[str, set[str]]:
    """Defaults of each option over all verbs, from the parser and from the help text."""
    found: dict[str, set[str]] = {}
    for verb in VERBS:
        for action in parser_of(verb)._actions:
            stated = re.findall(r"default:? ([-\w.]+[\w])", action.help or "")
            known = str(action.default)
            if isinstance(action.default, float | int) and not isinstance(action.default, bool):
                known = f"{action.default:g}"
                assert {value for value in stated if value[0].isdigit()} <= {known}, action.option_strings
            for option in action.option_strings:
                found[option] = found.get(option, set()) | {known, *stated}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_defaults_are_those_of_the_commands(page: Path, defaults: dict[str, set[str]]) -> None:
    """Check defaults in the forms `--option VALUE` (default X), and `--option X`, the default."""
    text = re.sub(r"\s+", " ", page.read_text())
    stated = re.findall(r"`(--[a-z0-9-]+)[^`]*` \(default ([-\w.]*\w)", text)
    stated += re.findall(r"`(--[a-z0-9-]+) ([-\w.]+)`, the default", text)
    for option, value in stated:
        if value[0].isdigit() or value in defaults.get(option, ()):
            assert value in defaults[option], f"{page.name}: {option} (default {value})"


def test_pages_state_defaults() -> None:
    """Without stated defaults, the test above would check nothing."""
    text = " ".join(page.read_text() for page in PAGES)
    assert len(re.findall(r"`--tolerance DB` \(default 0\.\d", text)) >= 4
