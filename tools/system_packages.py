"""System libraries and programs that pip cannot install, their Debian packages, and the line that installs them.

Standard library only, because the Makefile runs this before there is an environment. counterlight doctor uses it too.

    python3 tools/system_packages.py play|test      installs missing packages (as root), or prints the line to run
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

PYTHON_FLOOR = (3, 11)
DONE, BAD_INPUT = 0, 2


class Part(NamedTuple):
    """A requirement: its Debian package, a test without dpkg whether it is present, and its purpose."""

    package: str
    is_there: Callable[[], bool]
    purpose: str


def loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def runs(program: str) -> bool:
    return shutil.which(program, path=os.environ.get("PATH", "") + ":/usr/bin") is not None


def imports(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def has_dummy_screen_driver() -> bool:
    return any(any(Path("/usr").glob(f"{lib}/xorg/modules/drivers/dummy_drv.so")) for lib in ("lib", "lib64", "lib/*"))


# Verified on a bare Debian 12 without recommended packages: libgl1 depends, through libglx-mesa0, on the Mesa drivers
# (libgl1-mesa-dri, including llvmpipe); libegl1 alone does not.
PLAY = (
    Part("python3-venv", partial(imports, "ensurepip"), "the Python environment"),
    Part("libegl1", partial(loads, "libEGL.so.1"), "OpenGL without a screen"),
    Part("libgl1", partial(loads, "libGL.so.1"), "OpenGL and its drivers"),
    Part("libxrandr2", partial(loads, "libXrandr.so.2"), "monitors: without it GLFW sees a single one"),
)
TEST = (
    *PLAY,
    Part("xvfb", partial(runs, "Xvfb"), "windows in tests"),
    Part("xserver-xorg-core", partial(runs, "Xorg"), "two monitors in tests"),
    Part("xserver-xorg-video-dummy", has_dummy_screen_driver, "two monitors in tests"),
    Part("x11-xserver-utils", partial(runs, "xrandr"), "two monitors in tests"),
    *(Part(name, partial(runs, name), "window managers in tests") for name in ("openbox", "metacity", "icewm")),
    Part("chromium", partial(runs, "chromium"), "the remote's page in a browser, in tests"),
    Part("strace", partial(runs, "strace"), "the watch over what a show opens, in tests and make fuzz"),
)
SETS = {"play": PLAY, "test": TEST}


def missing(parts: Sequence[Part]) -> list[Part]:
    return [part for part in parts if not part.is_there()]


def apt_line(packages: Sequence[str]) -> str:
    """Returns the line that installs `packages` on Debian and its relatives, with sudo if needed."""
    sudo = "" if os.geteuid() == 0 else "sudo "
    return f"{sudo}apt-get update && {sudo}apt-get install --yes --no-install-recommends {' '.join(packages)}"


def install(packages: Sequence[str]) -> None:
    """Install Debian packages as root. A failed update is ignored, and a failed install shows in `missing`."""
    apt_get = ["apt-get", "-o", "DPkg::Lock::Timeout=300"]  # a machine that just booted may still run another apt
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    subprocess.run([*apt_get, "update"], env=quiet, check=False)
    subprocess.run([*apt_get, "install", "--yes", "--no-install-recommends", *packages], env=quiet, check=False)


def complain(message: str) -> int:
    print(f"error: {message}", file=sys.stderr)
    return BAD_INPUT


def main(argv: Sequence[str]) -> int:
    if sys.version_info < PYTHON_FLOOR:
        floor = ".".join(map(str, PYTHON_FLOOR))
        found = sys.version.split()[0]
        return complain(
            f"Python {floor} or newer is needed, {sys.executable} is {found}; try: make PYTHON=python{floor}"
        )
    parts = SETS[argv[0]]
    packages = [part.package for part in missing(parts)]
    if packages and os.geteuid() == 0 and runs("apt-get"):
        print(f"installing system packages: {' '.join(packages)}", flush=True)
        install(packages)
        packages = [part.package for part in missing(parts)]
    if packages:
        return complain(f"system packages are missing; run this line, then make again:\n{apt_line(packages)}")
    return DONE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
