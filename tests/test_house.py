"""The house: which way imports point, what the wheel holds, that every command answers, that the checkout stays small."""

import ast
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
    if not module.name.startswith("player.gl"):
        importlib.import_module(module.name)
print(*sorted(name for name in sys.modules if name.split(".")[0] in FORBIDDEN or name.startswith("player.gl")))
"""
READ_SHADERS = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib.resources import files
for resource in sorted(files("player.shaders").iterdir(), key=lambda resource: resource.name):
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


def imported(path: Path) -> set[str]:
    """Every module that a file imports at any level, functions included, by its full name."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno}: relative imports hide which way the arrows point"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def roots(path: Path) -> set[str]:
    return {name.partition(".")[0] for name in imported(path)}


def packages_on_disk() -> Iterator[str]:
    yield "player.shaders"
    for folder in ("player", "tools"):
        for path in sorted((ROOT / folder).rglob("__init__.py")):
            yield ".".join(path.parent.relative_to(ROOT).parts)


def package_folder(package: str) -> Path:
    mapped = PROJECT["tool"]["setuptools"]["package-dir"].get(package)
    return ROOT / (mapped or package.replace(".", "/"))


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
    importers = {path for path in sources("player", "tools", "shaders") if roots(path) & {"moderngl", "glfw", "glcontext"}}
    assert importers
    assert {path.parent for path in importers} == {ROOT / "player" / "gl"}


def test_every_import_is_a_declared_dependency() -> None:
    project = PROJECT["project"]
    extras = project["optional-dependencies"].values()
    requirements = [*project["dependencies"], *(requirement for extra in extras for requirement in extra)]
    declared = {distribution_key(requirement.partition(">=")[0]) for requirement in requirements}
    providers = metadata.packages_distributions()
    ours = {"player", "tools", "tests", "shaders"} | sys.stdlib_module_names
    undeclared = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources("player", "tools", "tests")
        for name in roots(path) - ours
        if not declared & {distribution_key(provider) for provider in providers.get(name, [])}
    }
    assert undeclared == set()


def test_every_declared_dependency_is_pinned() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line.partition("==") for line in lines if not line.startswith("#")]
    assert all(name and version for name, _, version in pins)  # no addresses, no options, no ranges
    pinned = {distribution_key(name) for name, _, _ in pins}
    installed = {distribution_key(name): version for name, _, version in pins}
    unpinned = {name for name in needed_distributions() if name not in pinned}
    assert unpinned == set()
    assert {name for name in installed if name not in needed_distributions()} == set()


def needed_distributions() -> set[str]:
    """The declared dependencies with the extras, and theirs in turn, as installed here."""
    project = PROJECT["project"]
    extras = project["optional-dependencies"].values()
    waiting = [*project["dependencies"], *(requirement for extra in extras for requirement in extra)]
    needed: set[str] = set()
    while waiting:
        requirement = waiting.pop()
        name = distribution_key(requirement)
        if name not in needed and applies(requirement):
            needed.add(name)
            waiting += metadata.requires(name) or []
    return needed


def distribution_key(requirement: str) -> str:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    return canonicalize_name(Requirement(requirement).name)
