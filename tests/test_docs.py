"""Pages of docs/: one a task, walked as a reader would; the index reaches all of them, and no link leads nowhere."""

import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.programs import ROOT, command

DOCS = ROOT / "docs"
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
        quality = re.search(r"camera PSNR ([\d.]+) dB", done.stdout)
        assert "--view" not in arguments or (quality and float(quality[1]) > 35), done.stdout  # wallpaper is gone
    assert cv2.imread("drive.png").shape == (18, 24, 3)
    assert cv2.imread("seen.png").shape == (24, 32, 3)


def test_every_page_is_in_the_index() -> None:
    linked = {(DOCS / target).resolve() for target in LINK.findall((DOCS / "README.md").read_text())}
    assert set(DOCS.glob("*.md")) - {DOCS / "README.md"} <= linked


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.glob("*.md"))], ids=lambda page: page.name)
def test_no_link_leads_nowhere(page: Path) -> None:
    targets = LINK.findall(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing
