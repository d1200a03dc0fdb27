"""House rules: the direction of imports, the content of the wheel, an answer from every command, a small checkout."""

import ast
import functools
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib import metadata
from pathlib import Path

import pytest

from counterlight.command import SCRIPTS
from counterlight.pipeline.views import VIEWS
from counterlight.tools.verbs import SHELLS, VERBS
from tests.programs import ROOT, fail, python, script, succeed

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LARGEST_FILE = 8 << 20
TIMEOUT_S = 120.0  # seconds for a command's imports on a busy machine

# Their modules import Numba, which imports scipy; no other module imports it before it multiplies.
COMPILED = tuple(
    f"counterlight.{name}" for name in (*("maps.products", "maps.word_runs", "pipeline.squares", "pipeline.survey"),)
)
HEAVY = {"scipy", "numba", "moderngl", "glcontext", "glfw"}
LOADED = "print(*(name for name in sys.modules if name.split('.')[0] in HEAVY or name.startswith(FOREIGN)))"
# folders of modules, and the names under which they are imported
FOLDERS = {"player": "counterlight", "tools": "counterlight.tools"}


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text() if path.exists() else "", path.name)


@functools.cache
def imported(path: Path) -> set[str]:
    """Returns the full name of every module that a file imports at any level, including in functions."""
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


def modules(folder: str) -> Iterator[str]:
    """Yield the import names of a folder's files, without `__main__`, which may import anything."""
    for path in sources(folder):
        if path.stem == "__main__":
            continue
        yield module_of(path)


def packages_on_disk() -> Iterator[str]:
    yield from ("counterlight.calib_data", "counterlight.shaders")
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("__init__.py")):
            yield ".".join((package, *path.parent.relative_to(ROOT / folder).parts))


def loaded_by(*names: str) -> list[str]:
    """Import modules in a fresh interpreter; return the loaded modules that are heavy or belong to the tools."""
    foreign = ("counterlight.tools", "counterlight.gl.")
    code = f"HEAVY, FOREIGN = {HEAVY!r}, {foreign!r}\nimport sys, {', '.join(names)}\n{LOADED}"
    return python("-c", code).split()


def test_the_player_without_opengl_imports_no_tool_no_scipy_no_window() -> None:
    assert loaded_by(*(name for name in modules("player") if not name.startswith(("counterlight.gl", *COMPILED)))) == []


def test_the_player_with_opengl_imports_no_numba() -> None:
    names = (name for name in modules("player") if not name.startswith(COMPILED))
    code = f"import sys, {', '.join(names)}\nprint('moderngl' in sys.modules, 'numba' in sys.modules)"
    assert python("-c", code).split() == ["True", "False"]


@pytest.mark.parametrize("module", ["maps.row_map", "pipeline.renderer", "calibration", "media.video", "app"])
def test_each_module_of_the_player_alone_needs_no_opengl(module: str) -> None:
    assert loaded_by(f"counterlight.{module}") == []


def test_nothing_in_the_player_imports_tools() -> None:
    tools = re.compile(r"counterlight\.tools\b")
    assert [path.stem for path in sources("player") if any(map(tools.match, imported(path)))] == [
        "__init__",
        "__main__",
    ]


def module_of(path: Path) -> str:
    """Returns the import name of a file of the player or the tools."""
    folder, *parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join((FOLDERS[folder], *(part for part in parts if part != "__init__")))


def test_no_file_imports_itself_through_others() -> None:
    """Imports for the type checker and in functions also count."""
    files = {module_of(path): imported(path) for path in sources("player", "tools")}
    arrows = {
        name: {target if target in files else target.rpartition(".")[0] for target in names} & files.keys() - {name}
        for name, names in files.items()
    }
    try:
        list(TopologicalSorter(arrows).static_order())
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


ROOMS = {  # folders of the player, and the folders that each may import
    "errors": "",
    "arrays": "errors",
    "memory": "errors",
    "command": "errors",
    "jobs": "errors",
    "writing": "errors",
    "files": "errors memory writing",
    "plots": "errors",
    "raster": "errors files",
    "response": "arrays errors files raster",
    "screen": "arrays errors files",
    "viewpoints": "errors files",
    "calibration": "arrays errors files raster response screen viewpoints writing",
    "maps": "arrays calibration errors files memory plots writing",
    "media": "errors files writing",
    "passes": "files maps media response",
    "pipeline": "arrays calibration errors files maps media passes raster response screen viewpoints writing",
    "overlay": "maps pipeline screen",
    "unattended": "command errors",
    "remote": "command errors unattended",
    "gl": "calibration command errors maps media overlay passes pipeline raster response unattended",
    "show": "calibration command errors files gl jobs maps media memory overlay passes pipeline raster remote "
    "unattended viewpoints writing",
    "app": "calibration command errors gl jobs media overlay pipeline show unattended writing",
}


TOOL_ROOMS = {  # folders of the tools, and the folders that each may import
    "transport": "",
    "hdr": "",
    "clusters": "transport",
    "colour": "transport",
    "ways": "transport",
    "relighting": "colour transport",
    "inverse": "clusters colour transport",
    "blurring": "inverse transport",
    "factoring": "blurring inverse transport",
    "joining": "colour factoring hdr transport",
    "solve": "clusters colour inverse relighting transport",
    "simulation": "blurring joining transport",
    "acquisition": "clusters colour factoring hdr inverse joining simulation solve transport",
    "report": "acquisition clusters colour inverse relighting solve transport ways",
    "exports": "inverse transport",
    "pairs": "hdr transport",
    "watching": "acquisition colour hdr transport",
    "study": "acquisition clusters colour inverse joining relighting report simulation solve transport",
}


@pytest.mark.parametrize(("folder", "allowed"), [("player", ROOMS), ("tools", TOOL_ROOMS)])
def test_the_rooms_know_what_they_may_and_no_more(folder: str, allowed: dict[str, str]) -> None:
    """Files in tools/ itself may import any folder, and any folder may import them."""
    rooms, prefix = {name: set(others.split()) for name, others in allowed.items()}, f"{FOLDERS[folder]}."
    list(TopologicalSorter(rooms).static_order())  # no two import each other
    assert {path.parent.name for path in (ROOT / folder).glob("*/__init__.py")} <= rooms.keys()
    files = {path.stem for path in (ROOT / folder).glob("*.py")} - rooms.keys()
    known: dict[str, set[str]] = {name: set() for name in rooms}
    for path in sources(folder):
        room = path.relative_to(ROOT / folder).with_suffix("").parts[0]
        assert room in rooms or room in files
        if room in rooms:
            names = [name.removeprefix(prefix).split(".")[0] for name in imported(path) if name.startswith(prefix)]
            known[room] |= set(names) - {room} - files
    assert {name: sorted(others - rooms[name]) for name, others in known.items() if others - rooms[name]} == {}


def test_only_player_gl_imports_moderngl_and_glfw() -> None:
    opengl = {"moderngl", "glcontext", "glfw"}
    importers = {path for path in sources("player", "tools", "shaders") if roots(path) & opengl}
    assert importers
    assert {path.parent for path in importers} == {ROOT / "player" / "gl"}


def test_every_import_is_a_declared_dependency() -> None:
    providers, known = metadata.packages_distributions(), declared()
    ours = {"counterlight", "tests"} | sys.stdlib_module_names
    undeclared = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources("player", "tools", "tests")
        for name in roots(path) - ours
        if not known & {normal_name(provider) for provider in [name, *providers.get(name, [])]}
    }
    assert undeclared == set()


def test_every_dependency_is_pinned_by_version_alone() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert [line for line in pins if not re.fullmatch(r"[\w.-]+==[\w.]+", line)] == []  # no addresses, no options
    assert declared() - {normal_name(line) for line in pins} == set()


def declared() -> set[str]:
    """Dependencies in pyproject.toml, including extras."""
    project = PROJECT["project"]
    extras = project["optional-dependencies"].values()
    return {normal_name(requirement) for group in (project["dependencies"], *extras) for requirement in group}


def normal_name(requirement: str) -> str:
    """Normalise a requirement to a package name: `tomli_w==1.2.0` -> `tomli-w`."""
    return re.sub(r"[-_.]+", "-", re.split(r"[<>=!~;\[ ]", requirement)[0]).lower()


def test_the_wheel_lists_every_package_and_no_other() -> None:
    assert sorted(PROJECT["tool"]["setuptools"]["packages"]) == sorted(packages_on_disk())


def test_every_folder_of_modules_is_a_package_with_a_docstring() -> None:
    folders = {path.parent for path in sources("player", "tools", "shaders", "calib_data")}
    undocumented = [folder for folder in sorted(folders) if not ast.get_docstring(parsed(folder / "__init__.py"))]
    assert undocumented == []


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_answers_help(verb: str) -> None:
    assert f"usage: counterlight {verb} " in succeed(verb, "--help")


def test_the_command_lists_its_verbs_and_names_the_nearest() -> None:
    listed = succeed("--help")
    assert all(f"  {verb} " in listed for verb in VERBS)
    assert succeed("--version") == f"counterlight {PROJECT['project']['version']}\n"
    assert "no verb 'bild'; did you mean 'build'?" in fail("bild")
    assert "did you mean '--regularize'?" in fail("build", "room", "--regularise", "0.1")
    assert "did you mean '--colour'?" in fail("build", "room", "--color", "pixel")
    for option in ("--color", "--report"):  # --follow and --remote are different words
        assert fail("play", "room", "x.png", option) == (
            f"error: counterlight play: unrecognized arguments: {option}; see counterlight play --help"
        )
    assert "invalid choice: 'hierarchic' " in (line := fail("acquire", "--scheme", "hierarchic"))
    assert line.endswith("did you mean 'hierarchical'?; see counterlight acquire --help")


@pytest.mark.parametrize(("verb", "name"), SCRIPTS.items())
def test_the_scripts_that_the_mission_names_are_verbs_of_their_own(verb: str, name: str) -> None:
    words = [script(name), "--help"]
    own = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S, check=True).stdout
    assert own.split()[:2] == ["usage:", name]
    assert own.split("\n\n", 1)[1] == succeed(verb, "--help").split("\n\n", 1)[1]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("counterlight ver", {"verify"}),
        ("counterlight build --re", {"--regularize", "--report"}),
        ("counterlight acquire --scheme h", {"hierarchical"}),
        ("counterlight play room --view ", set(VIEWS)),
        ("play-corrected --dit", {"--dither"}),
        ("build-correction-map room --outside b", {"black"}),
    ],
)
def test_shells_complete_verbs_options_and_choices(line: str, expected: set[str], tmp_path: Path) -> None:
    """Complete words as argcomplete's scripts for the shells do."""
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9", "IFS": "\v"}
    environment = os.environ | asked | {"_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "found")}
    subprocess.run([script(line.split()[0])], env=environment, cwd=tmp_path, timeout=TIMEOUT_S, check=False)
    assert {word.strip() for word in (tmp_path / "found").read_text().split("\v")} == expected


@pytest.mark.parametrize("shell", SHELLS)
def test_completion_prints_what_a_shell_runs(shell: str) -> None:
    printed = succeed("completion", shell)
    assert all(name in printed for name in ("counterlight", *SCRIPTS.values()))


def test_no_file_of_the_checkout_is_large() -> None:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = [ROOT / name for name in listing.split("\0") if name]
    assert paths
    assert [path for path in paths if path.is_file() and path.stat().st_size > LARGEST_FILE] == []


def test_every_promise_of_docs_security_has_a_test() -> None:
    rows = [line for line in (ROOT / "docs" / "security.md").read_text().splitlines() if line.startswith("|")]
    promises = [row for row in rows if not re.match(r"\| (source|party) \||\|---", row)]
    named = [re.findall(r"`(test_\w+)`", row.rpartition(" | ")[2]) for row in promises]
    assert len(named) > 20
    assert [row for row, names in zip(promises, named, strict=True) if not names] == []
    there = {name for path in sources("tests") for name in re.findall(r"^ *def (test_\w+)", path.read_text(), re.M)}
    assert {name for names in named for name in names} - there == set()
