"""The wheel contains everything: the main job works with the wheel alone, far from the checkout."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

import counterlight
from tests.programs import ROOT, python

READ_SHADERS = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib.resources import files
for resource in sorted(files("counterlight.shaders").iterdir(), key=lambda resource: resource.name):
    if resource.is_file() and not resource.name.endswith((".py", ".pyc")):
        print(resource.name, resource.read_bytes().hex())
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy, so that the checkout stays clean."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "source"
    left_out = shutil.ignore_patterns("__pycache__", "*.egg-info", "example*")
    for name in ("player", "tools", "shaders", "calib_data"):
        shutil.copytree(ROOT / name, copy / name, ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    python("-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(copy))
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """Return the programs of a new environment with the wheel, borrowed dependencies and no checkout."""
    environment = wheel.parent / "environment"
    python("-m", "venv", "--without-pip", str(environment))
    (packages,) = environment.glob("lib/python*/site-packages")
    python("-m", "pip", "--python", str(environment / "bin" / "python"), "install", "--no-deps", "--quiet", str(wheel))
    # .pth files in the borrowed folder are not read
    (packages / "borrowed.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    borrow_what_is_compiled(packages / "counterlight")
    return environment / "bin"


def borrow_what_is_compiled(package: Path) -> None:
    """Copy Numba's compiled code, whose file names contain size and time. Compiling everything again takes a minute."""
    kept = Path(counterlight.__file__).parent
    for index in kept.rglob("__pycache__/*.nb[ic]"):
        borrowed = package / index.relative_to(kept)
        borrowed.parent.mkdir(exist_ok=True)
        shutil.copy(index, borrowed)
    for module in package.rglob("*.py"):
        found = (kept / module.relative_to(package)).stat()
        os.utime(module, ns=(found.st_atime_ns, found.st_mtime_ns))


@pytest.fixture(scope="module")
def unpacked_wheel(wheel: Path) -> Path:
    """Unpack the wheel as pip would."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(wheel.parent / "unpacked")
    return wheel.parent / "unpacked"


def test_every_shader_loads_from_the_built_wheel(unpacked_wheel: Path) -> None:
    expected = {path.name: path.read_bytes() for path in (ROOT / "shaders").iterdir() if is_shader(path)}
    assert expected
    # -I -S: no checkout and no site-packages, so that only the wheel can answer.
    lines = python("-I", "-S", "-B", "-c", READ_SHADERS, str(unpacked_wheel)).splitlines()
    found = {name: bytes.fromhex(content) for name, content in (line.split() for line in lines)}
    assert found == expected


def is_shader(path: Path) -> bool:
    return path.is_file() and path.suffix not in (".py", ".pyc")


def test_the_wheel_holds_one_package_with_every_module_scene_and_clip(unpacked_wheel: Path) -> None:
    found = {path.relative_to(unpacked_wheel).as_posix() for path in unpacked_wheel.rglob("*") if path.is_file()}
    ours = {name for name in found if not name.startswith("counterlight-")}  # all other files belong to pip
    names = {"player": "", "tools": "tools/", "shaders": "shaders/", "calib_data": "calib_data/"}
    listing = subprocess.run(["git", "ls-files", *names], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = [name.partition("/") for name in listing.splitlines() if (ROOT / name).exists()]
    assert ours == {f"counterlight/{names[folder]}{path}" for folder, _, path in paths}


def test_the_main_job_from_a_wheel_in_a_foreign_folder(installed: Path, tmp_path: Path) -> None:
    users = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(installed / words[0]), *words[1:]],
            env=users, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip

    def succeed(*words: str) -> str:
        done = run(*words)
        assert done.returncode == 0, done.stderr
        return done.stdout

    (tmp_path / "tools").mkdir()  # a folder of the user, not of the package
    (tmp_path / "tools" / "__init__.py").write_text("raise SystemExit('a foreign package')")
    where = succeed("python", "-c", "import counterlight; print(counterlight.__file__)")
    assert Path(where.strip()).is_relative_to(installed.parent)
    succeed("counterlight", "simulate", "corner", "--camera", "48x27", "--projector", "40x24", "-o", "room")
    succeed("build-correction-map", "room", "--regularize", "0.1")
    clip = succeed("python", "-c", "from counterlight.tools.shipped import CLIP; print(CLIP)").strip()
    succeed("play-corrected", "room", clip, "--no-config", "--frames", "2", "--output", "drive.png")
    assert (tmp_path / "drive.png").stat().st_size > 0
    refused = run("counterlight", "study", "--scenes", "cornr")
    assert refused.returncode == 2
    assert "there are corner, folded_cards, folded_wall, glass, " in refused.stderr
