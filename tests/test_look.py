"""The colour table of a show: set, read again, refused. The border limits the names that a remote may use."""

from pathlib import Path

import numpy as np
import pytest

from counterlight.media.medium import Border
from counterlight.show.media import Media
from counterlight.show.registry import CommandError
from tests.cubes import write_cube
from tests.stage import Screen, Stage


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    made = Stage()
    made.cube = Media(Border((str(tmp_path),))).cube  # type: ignore[attr-defined]
    made.advance(0.1)
    return made


def test_a_table_is_set_and_taken_away(stage: Stage, rng: np.random.Generator, tmp_path: Path) -> None:
    path = write_cube(tmp_path / "look.cube", rng, 3)
    assert stage.commands.get("lut") == "no"
    stage.commands.set("lut", str(path))
    assert stage.commands.get("lut") == str(path)
    cube = stage.screen.adjusted[-1].lut
    assert cube is not None
    assert cube.table.shape == (3, 3, 3, 3)
    for word in ("no", ""):
        stage.commands.set("lut", word)
        assert stage.screen.adjusted[-1].lut is None


def test_what_is_no_table_changes_nothing(stage: Stage, rng: np.random.Generator, tmp_path: Path) -> None:
    path = write_cube(tmp_path / "look.cube", rng, 3)
    stage.commands.set("lut", str(path))
    (tmp_path / "bad.cube").write_text("LUT_3D_SIZE 2\n0 0 0\n")
    cases: list[tuple[object, str]] = [
        (str(tmp_path / "bad.cube"), "1 colours, LUT_3D_SIZE 2 promises 8"),
        (str(tmp_path / "none.cube"), "no such file"),
        (str(tmp_path), "is a folder"),
        (7, "expected the name of a .cube file or no, found 7"),
    ]
    for name, message in cases:
        with pytest.raises(CommandError, match=message):
            stage.commands.set("lut", name)
        assert stage.commands.get("lut") == str(path)


def test_reload_reads_the_table_again(stage: Stage, rng: np.random.Generator, tmp_path: Path) -> None:
    path = write_cube(tmp_path / "look.cube", rng, 3)
    stage.commands.set("lut", str(path))
    stage.fresh = [Screen(), Screen()]
    write_cube(path, rng, 4)
    assert stage.press("ctrl+r") == "maps and shaders reloaded"
    cube = stage.session.adjustments.lut
    assert cube is not None
    assert len(cube.table) == 4
    path.write_text("LUT_3D_SIZE 4\n")
    assert "0 colours" in stage.press("ctrl+r")
    assert stage.session.adjustments.lut is cube
    assert len(stage.fresh) == 1  # the room was not read


def test_a_remote_names_tables_below_its_roots_and_nothing_else(rng: np.random.Generator, tmp_path: Path) -> None:
    inside, outside = tmp_path / "media", tmp_path / "elsewhere"
    for folder in (inside, outside):
        folder.mkdir()
        write_cube(folder / "look.cube", rng, 2)
    (inside / "link.cube").symlink_to(outside / "look.cube")
    media = Media(Border((str(inside),)))
    stage = Stage()
    stage.cube = media.cube  # type: ignore[attr-defined]
    stage.commands.set("lut", str(inside / "look.cube"))
    for name in (outside / "look.cube", inside / "link.cube", inside / ".." / "elsewhere" / "look.cube"):
        with pytest.raises(CommandError, match="may name files below its folder"):
            stage.commands.set("lut", str(name))
    with pytest.raises(CommandError, match="only the command line may name devices"):
        stage.commands.set("lut", "lavfi:testsrc")
