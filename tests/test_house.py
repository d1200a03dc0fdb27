"""The house: which way imports point, what the wheel holds, that every command answers and the checkout stays small."""

import ast
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LARGEST_FILE = 8 << 20
TIMEOUT_S = 120.0  # a command's imports on a busy machine

IMPORT_PLAYER = """
import importlib, pkgutil, sys, player
for module in pkgutil.walk_packages(player.__path__, "player."):
    if not module.name.startswith(("counterlight.gl", "counterlight.products")):  # products: Numba, which imports scipy
        importlib.import_module(module.name)
print(*sorted(name for name in sys.modules if name.split(".")[0] in FORBIDDEN or name.startswith("counterlight.gl.")))
"""
READ_SHADERS = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib.resources import files
for resource in sorted(files("counterlight.shaders").iterdir(), key=lambda resource: resource.name):
    if resource.is_file() and not resource.name.endswith((".py", ".pyc")):
        print(resource.name, resource.read_bytes().hex())
"""


def python(*arguments: str) -> str:
    """What a fresh interpreter prints; the test fails with its error output if it does not end well."""
    outcome = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, timeout=TIMEOUT_S, check=False
    )
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text() if path.exists() else "", path.name)


def imported(path: Path) -> set[str]:
    """Every module that a file imports at any level, functions included, by its full name."""
    names: set[str] = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno}: relative imports hide which way the arrows point"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def roots(path: Path) -> set[str]:
    return {name.partition(".")[0] for name in imported(path)}


def packages_on_disk() -> Iterator[str]:
    yield "counterlight.shaders"
    for folder in ("player", "tools"):
        for path in sorted((ROOT / folder).rglob("__init__.py")):
            yield ".".join(path.parent.relative_to(ROOT).parts)


def test_the_player_without_opengl_imports_no_tool_no_scipy_no_window() -> None:
    forbidden = {"tools", "scipy", "moderngl", "glcontext", "glfw"}
    assert python("-c", f"FORBIDDEN = {forbidden!r}\n{IMPORT_PLAYER}").split() == []


@pytest.mark.parametrize("module", ["row_map", "reference", "calibration", "video", "app"])
def test_each_module_of_the_player_alone_needs_no_opengl(module: str) -> None:
    code = f"import sys, player.{module}\nprint(*(sys.modules.keys() & {{'tools', 'scipy', 'moderngl', 'glfw'}}))"
    assert python("-c", code).split() == []


def test_nothing_in_the_player_imports_tools() -> None:
    assert [path for path in sources("player") if "tools" in roots(path)] == []


def test_only_player_gl_imports_moderngl_and_glfw() -> None:
    opengl = {"moderngl", "glcontext", "glfw"}
    importers = {path for path in sources("player", "tools", "shaders") if roots(path) & opengl}
    assert importers
    assert {path.parent for path in importers} == {ROOT / "player" / "gl"}


def test_every_import_is_a_declared_dependency() -> None:
    providers = metadata.packages_distributions()
    ours = {"player", "tools", "tests"} | sys.stdlib_module_names
    undeclared = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources("player", "tools", "tests")
        for name in roots(path) - ours
        if not declared() & {normal_name(provider) for provider in [name, *providers.get(name, [])]}
    }
    assert undeclared == set()


def test_every_dependency_is_pinned_by_version_alone() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert [line for line in pins if not re.fullmatch(r"[\w.-]+==[\w.]+", line)] == []  # no addresses, no options
    assert declared() - {normal_name(line) for line in pins} == set()


def declared() -> set[str]:
    """The dependencies of pyproject.toml, extras included."""
    project = PROJECT["project"]
    extras = project["optional-dependencies"].values()
    return {normal_name(requirement) for group in (project["dependencies"], *extras) for requirement in group}


def normal_name(requirement: str) -> str:
    """`tomli_w==1.2.0` -> `tomli-w`."""
    return re.sub(r"[-_.]+", "-", re.split(r"[<>=!~;\[ ]", requirement)[0]).lower()


def test_the_wheel_lists_every_package_and_no_other() -> None:
    assert sorted(PROJECT["tool"]["setuptools"]["packages"]) == sorted(packages_on_disk())


def test_every_folder_of_modules_is_a_package_with_a_docstring() -> None:
    folders = {path.parent for path in sources("player", "tools", "shaders")}
    undocumented = [folder for folder in sorted(folders) if not ast.get_docstring(parsed(folder / "__init__.py"))]
    assert undocumented == []


@pytest.fixture(scope="module")
def unpacked_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy so that the checkout stays clean, as pip would lay it out."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "source"
    left_out = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("player", "tools", "shaders"):
        shutil.copytree(ROOT / name, copy / name, ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    python("-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(copy))
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "installed")
    return folder / "installed"


def test_every_shader_loads_from_the_built_wheel(unpacked_wheel: Path) -> None:
    expected = {path.name: path.read_bytes() for path in (ROOT / "shaders").iterdir() if is_shader(path)}
    assert expected
    # -I -S: no checkout, no site-packages, so that only the wheel can answer.
    lines = python("-I", "-S", "-c", READ_SHADERS, str(unpacked_wheel)).splitlines()
    found = {name: bytes.fromhex(content) for name, content in (line.split() for line in lines)}
    assert found == expected


def is_shader(path: Path) -> bool:
    return path.is_file() and path.suffix not in (".py", ".pyc")


def test_every_module_is_in_the_built_wheel(unpacked_wheel: Path) -> None:
    expected = {path.relative_to(ROOT) for path in sources("player", "tools")}
    found = {path.relative_to(unpacked_wheel) for path in unpacked_wheel.rglob("*.py")}
    assert found - {Path("player/shaders/__init__.py")} == expected


@pytest.mark.parametrize("name", PROJECT["project"]["scripts"])
def test_every_command_answers_help(name: str) -> None:
    module, _, function = PROJECT["project"]["scripts"][name].partition(":")
    code = f"import sys\nfrom {module} import {function}\nsys.argv = ['{name}', '--help']\nsys.exit({function}())"
    assert f"usage: {name}" in python("-c", code)


def test_no_file_of_the_checkout_is_large() -> None:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = [ROOT / name for name in listing.split("\0") if name]
    assert paths
    assert [path for path in paths if path.is_file() and path.stat().st_size > LARGEST_FILE] == []


def test_every_promise_of_docs_security_has_a_test() -> None:
    rows = [line for line in (ROOT / "docs" / "security.md").read_text().splitlines() if line.startswith("|")]
    promises = [row for row in rows if not re.match(r"\| (said by|by|who) \||\|---", row)]
    named = [re.findall(r"`(test_\w+)`", row.rpartition(" | ")[2]) for row in promises]
    assert len(named) > 20
    assert [row for row, names in zip(promises, named, strict=True) if not names] == []
    there = {
        node.name for path in sources("tests") for node in ast.walk(parsed(path)) if isinstance(node, ast.FunctionDef)
    }
    assert {name for names in named for name in names} - there == set()
