"""counterlight doctor: what this machine has, what is missing, and the exact fix for each.

The report must not depend on the packages that it checks. Packages are therefore imported late, one at a time, and
OpenGL and GLFW run in child processes (counterlight.gl.probe), so that a crashing driver becomes a line of the report.
"""

import dataclasses
import importlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from counterlight.command import BAD_INPUT, DONE, Parser, command_line, conclusion, verb
from counterlight.tools.system_packages import PLAY, PYTHON_FLOOR, TEST, apt_line, missing, runs

PROBE_S = 60.0  # time limit in seconds; a software renderer's first context on a busy machine takes several
SMALLEST_TEXTURE = 4096
IMPORT_NAMES = {
    "opencv-contrib-python-headless": "cv2",
    "tomli-w": "tomli_w",
    "scikit-image": "skimage",
    "colour-science": "colour",
    "Pillow": "PIL",
    "python-osc": "pythonosc",
}
EXTRAS = (  # purpose, package, extra of pyproject.toml
    ("camera RAW", "rawpy", "raw"),
    ("machine-vision cameras", "pypylon", "pylon"),
    ("plots of studies", "matplotlib", "study"),
    ("remote in a browser", "websockets", "remote"),
    ("its address as a QR code", "segno", "remote"),
    ("Open Sound Control", "python-osc", "osc"),
    ("jobs on many machines", "distributed", "cluster"),
)


@dataclass(frozen=True)
class Finding:
    """One line of the report. `missing` stops the player; `note` disables only the named feature."""

    subject: str
    state: Literal["ok", "note", "missing"]
    found: str
    fix: str = ""


EXAMPLES = "counterlight doctor", "counterlight doctor --json"


@verb
def main(argv: Sequence[str] | None) -> int:
    """Returns exit code 0 if the player can at least render without a screen, 2 if a requirement is missing."""
    parser = Parser(
        "doctor", description="Check what this machine has, what is missing, and how to install it.", examples=EXAMPLES
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    options = parser.parse_args(argv)
    findings = examine()
    ready = all(finding.state != "missing" for finding in findings)
    print(as_json(findings, ready) if options.json else as_text(findings, ready))
    return DONE if ready else BAD_INPUT


def examine() -> list[Finding]:
    checks: tuple[Callable[[], list[Finding]], ...] = (
        check_python,
        check_packages,
        check_system_packages,
        check_opengl,
        check_screen,
        check_ffmpeg,
        check_openexr,
        check_cameras,
        check_sound,
        check_extras,
        check_letters,
        check_size,
    )
    return [finding for check in checks for finding in check()]


def as_text(findings: Sequence[Finding], ready: bool) -> str:
    lines = []
    for finding in findings:
        lines.append(f"{finding.state:8}{finding.subject}: {finding.found}")
        if finding.fix:
            lines.append(f"{'':8}fix: {finding.fix}")
    if ready:
        lines.append(conclusion("ready: the player can run here", command_line("example")))
    else:
        action = f"run the commands after fix:, then {command_line('doctor')}"
        lines.append(conclusion("not ready: something required is missing", action))
    return "\n".join(lines)


def as_json(findings: Sequence[Finding], ready: bool) -> str:
    return json.dumps({"ready": ready, "findings": [dataclasses.asdict(finding) for finding in findings]}, indent=2)


def check_python() -> list[Finding]:
    found = f"{sys.version.split()[0]} ({sys.executable})"
    if sys.version_info >= PYTHON_FLOOR:
        return [Finding("Python", "ok", found)]
    floor = ".".join(map(str, PYTHON_FLOOR))
    return [Finding("Python", "missing", f"{found}, {floor} or newer is needed", f"make PYTHON=python{floor} play")]


def check_packages() -> list[Finding]:
    """Check each package that pyproject.toml requires: its version, and whether it can be imported."""
    try:
        requirements = metadata.requires("counterlight") or []
    except metadata.PackageNotFoundError:
        return [Finding("counterlight", "missing", "not installed", f"{sys.executable} -m pip install -e .")]
    required = [requirement for requirement in requirements if "extra ==" not in requirement]
    return [check_package(requirement) for requirement in required]


def check_package(requirement: str) -> Finding:
    name, _, floor = requirement.partition(";")[0].partition(">=")
    fix = f"{sys.executable} -m pip install '{requirement}'"
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Finding(name, "missing", f"not installed, {floor} or newer is needed", fix)
    if _numbers(version) < _numbers(floor):
        return Finding(name, "missing", f"{version}, {floor} or newer is needed", fix)
    module = IMPORT_NAMES.get(name, name)
    if module not in ("moderngl", "glfw"):  # only counterlight.gl imports these two, in a child process
        try:
            with warnings.catch_warnings(record=True):  # colour-science warns about missing optional packages
                warnings.simplefilter("ignore")
                importlib.import_module(module)
        except Exception as error:  # only the first sentence, because the report adds its own fix
            return Finding(name, "missing", f"{version}, import fails: {_one_line(error)}", f"{fix} --force-reinstall")
    return Finding(name, "ok", f"{version} (needs {floor})")


def check_system_packages() -> list[Finding]:
    """Check libraries that the player loads; packages that only the tests need are a note."""
    findings = []
    absent = missing(PLAY)
    if absent:
        what = ", ".join(f"{part.package} ({part.purpose})" for part in absent)
        findings.append(Finding("system packages", "missing", what, apt_line([part.package for part in absent])))
    for_tests = [part for part in missing(TEST) if part not in absent]
    if for_tests:
        what = ", ".join(part.package for part in for_tests) + " (make test needs them)"
        findings.append(Finding("test packages", "note", what, apt_line([part.package for part in for_tests])))
    return findings or [Finding("system packages", "ok", ", ".join(part.package for part in TEST))]


def check_opengl() -> list[Finding]:
    """Check OpenGL without a window, the minimum for the player."""
    answer = probe("opengl")
    if "error" in answer:
        return [Finding("OpenGL through EGL", "missing", answer["error"], opengl_fix())]
    software = "software (llvmpipe): " if "llvmpipe" in answer["renderer"] else ""
    size = answer["max_texture_size"]
    found = f"{software}{answer['vendor']}, {answer['renderer']}, {answer['version']}, textures up to {size}"
    if size < SMALLEST_TEXTURE:
        return [Finding("OpenGL through EGL", "missing", found, "use a GPU or driver with textures of 4096 and more")]
    return [Finding("OpenGL through EGL", "ok", found)]


def opengl_fix() -> str:
    """Returns the fix; environment variables that hide the drivers come first, because reinstalling would not help."""
    hiding = [name for name in ("__EGL_VENDOR_LIBRARY_DIRS", "__EGL_VENDOR_LIBRARY_FILENAMES") if name in os.environ]
    if hiding:
        return f"unset {' '.join(hiding)}"
    return apt_line(["libegl1", "libgl1", "libgl1-mesa-dri"])


def check_screen() -> list[Finding]:
    """Check windows and monitors, which rendering to a file does not need."""
    variables = [f"{name}={os.environ[name]}" for name in ("DISPLAY", "WAYLAND_DISPLAY") if os.environ.get(name)]
    system = " ".join(variables) or "neither DISPLAY nor WAYLAND_DISPLAY is set"
    answer = probe("screen")
    if "error" in answer:
        return [Finding("window system", "note", f"{system}; {answer['error']}", screen_fix())]
    monitors = [Finding("monitor", "ok", monitor["text"]) for monitor in answer["monitors"]]
    nothing = Finding("monitor", "note", "none is connected", "plug the projector in and switch it on")
    return [Finding("window system", "ok", system), *(monitors or [nothing])]


def screen_fix() -> str:
    packages = [package for package, program in (("xvfb", "Xvfb"), ("xauth", "xauth")) if not runs(program)]
    first = f", after: {apt_line(packages)}" if packages else ""
    return f"--output FILE needs none; a screen in memory: xvfb-run -a COMMAND{first}"


def probe(what: str) -> dict[str, Any]:
    """Run a probe in a child process; returns `{"error": …}` if the child fails."""
    command = [sys.executable, "-m", "counterlight.gl.probe", what]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_S, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"the driver did not answer within {PROBE_S:.0f} s"}
    if child.returncode < 0:
        return {"error": f"the driver crashed with {signal.Signals(-child.returncode).name}"}
    try:
        answer: dict[str, Any] = json.loads(child.stdout)
    except ValueError:
        return {"error": (child.stderr.strip().splitlines() or ["no answer"])[-1]}
    if "error" in answer:
        return {"error": answer["error"].partition(";")[0]}  # the report adds its own fix
    return answer


def check_ffmpeg() -> list[Finding]:
    try:
        import av

        version = av.ffmpeg_version_info
        encoders = av.codecs_available
    except Exception as error:
        return [Finding("FFmpeg", "missing", _one_line(error), _reinstall("av"))]
    if "libx264" in encoders:
        return [Finding("FFmpeg", "ok", f"{version} in PyAV, with libx264")]
    found = f"{version} in PyAV, without libx264: --output cannot write H.264"
    return [Finding("FFmpeg", "note", found, _reinstall("av"))]


def check_openexr() -> list[Finding]:
    """Check that a small picture can be written and read back exactly."""
    try:
        import numpy as np

        from counterlight.files.exr import read_channels, write_channels

        written = np.linspace(-1, 1e4, 35, dtype=np.float32).reshape(5, 7)
        with tempfile.TemporaryDirectory() as folder:
            write_channels(Path(folder) / "picture.exr", {"Y": written})
            same = np.array_equal(read_channels(Path(folder) / "picture.exr")["Y"], written)
    except Exception as error:
        return [Finding("OpenEXR files", "missing", _one_line(error), _reinstall("OpenEXR"))]
    if same:
        return [Finding("OpenEXR files", "ok", "written and read back exactly")]
    return [Finding("OpenEXR files", "missing", "read back other values than were written", _reinstall("OpenEXR"))]


def check_cameras() -> list[Finding]:
    devices = sorted(Path("/dev").glob("video*"))
    if not devices:
        return [Finding("camera", "note", "no /dev/video*: nothing to capture with", "plug a camera in")]
    return [check_camera(device) for device in devices]


def check_camera(device: Path) -> Finding:
    label = Path("/sys/class/video4linux") / device.name / "name"
    found = f"{device} {label.read_text().strip() if label.exists() else ''}".strip()
    if os.access(device, os.R_OK | os.W_OK):
        return Finding("camera", "ok", found)
    return Finding("camera", "note", f"{found}, not accessible", "sudo usermod -aG video $USER, then log in again")


def check_sound() -> list[Finding]:
    """Check the sound output in a child process, because PortAudio prints its failures to the terminal."""
    if importlib.util.find_spec("sounddevice") is None:
        return [Finding("sound", "note", "not installed: films are silent", _extra("audio"))]
    question = "import sounddevice; print(sounddevice.query_devices(kind='output')['name'])"
    try:
        command = [sys.executable, "-c", question]
        child = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_S, check=False)
    except subprocess.TimeoutExpired:
        return [Finding("sound", "note", f"the sound system did not answer within {PROBE_S:.0f} s", "see its log")]
    if child.returncode == 0:
        return [Finding("sound", "ok", child.stdout.strip())]
    why = (child.stderr.strip().splitlines() or ["no answer"])[-1]
    if "PortAudio library not found" in why:
        return [Finding("sound", "note", why, apt_line(["libportaudio2"]))]
    return [Finding("sound", "note", why, "plug an output in, or play with --no-audio")]


def check_extras() -> list[Finding]:
    """Check packages that only one kind of input, output or remote needs."""
    return [_extra_package(*extra) for extra in EXTRAS]


def _extra_package(subject: str, package: str, extra: str) -> Finding:
    if importlib.util.find_spec(IMPORT_NAMES.get(package, package)) is None:
        return Finding(subject, "note", f"{package} is not installed", _extra(extra))
    return Finding(subject, "ok", f"{package} {metadata.version(package)}")


def check_letters() -> list[Finding]:
    """Check for fontconfig, which finds fonts for letters that the player's font lacks."""
    if shutil.which("fc-match"):
        return [Finding("letters", "ok", "DejaVu Sans, and the system's fonts for what it lacks")]
    found = "DejaVu Sans alone: Chinese, Japanese or Korean titles show boxes"
    return [Finding("letters", "note", found, apt_line(["fontconfig", "fonts-noto-cjk"]))]


def check_size() -> list[Finding]:
    cores = len(os.sched_getaffinity(0))
    return [Finding("cores", "ok", str(cores)), Finding("free memory", "ok", free_memory())]


def free_memory() -> str:
    try:
        kilobytes = re.search(r"^MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(), re.MULTILINE)
    except OSError:
        kilobytes = None
    return f"{int(kilobytes[1]) / 2**20:.1f} GiB" if kilobytes else "unknown"


def _numbers(version: str) -> tuple[int, ...]:
    """Convert `1.17.1rc1` to (1, 17, 1), for comparison with a minimum version."""
    leading = re.match(r"\d+(\.\d+)*", version)
    return tuple(int(part) for part in leading[0].split(".")) if leading else ()


def _extra(name: str) -> str:
    return f"{sys.executable} -m pip install 'counterlight[{name}]'"


def _reinstall(package: str) -> str:
    return f"{sys.executable} -m pip install --force-reinstall {package}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
