"""X servers for tests, ended by the process that started them: one screen (Xvfb), two monitors (Xorg, dummy driver).

GLFW does not see monitors from xrandr --setmonitor, a second Xvfb screen or Xinerama, so two monitors need Xorg.
"""

import os
import select
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

START_S = 30.0  # an idle machine needs one second
KNOWN_MODES = "1280x720", "1024x768"  # modes of the dummy driver
TWO_MONITORS = """
Section "ServerFlags"
  Option "AutoAddDevices" "false"
  Option "AutoAddGPU" "false"
  Option "DontVTSwitch" "true"
EndSection
Section "Monitor"
  Identifier "monitor"
  HorizSync 5.0-1000.0
  VertRefresh 5.0-200.0
EndSection
Section "Device"
  Identifier "card"
  Driver "dummy"
  VideoRam 256000
EndSection
Section "Screen"
  Identifier "screen"
  Device "card"
  Monitor "monitor"
  DefaultDepth 24
  SubSection "Display"
    Depth 24
    Virtual 4096 2048
  EndSubSection
EndSection
"""


class NoServerError(Exception):
    """An X server did not start; the message says why and what to install."""


@contextmanager
def one_screen(folder: Path, size: tuple[int, int] = (1280, 720), display: str = "", depth: int = 24) -> Iterator[str]:
    """Run Xvfb with one screen of (width, height) and yield its DISPLAY, which may be given.

    depth : bits per pixel, 24, or 30 for 10-bit codes.
    folder : receives the server's log.
    """
    screen = f"{size[0]}x{size[1]}x{depth}"
    with _server(["Xvfb", *display.split(), "-screen", "0", screen], folder / "xvfb.log") as display:
        yield display


def reserved_display() -> str:
    """Return a DISPLAY far above the numbers that X servers choose, for a screen that starts late or again."""
    return f":{1000 + os.getpid() % 50_000}"


@contextmanager
def two_monitors(
    folder: Path, first: tuple[int, int] = (1280, 720), second: tuple[int, int] = (1024, 768)
) -> Iterator[str]:
    """Run Xorg with DUMMY0 (primary) and DUMMY1 to its right; yield its DISPLAY.

    first, second : (width, height) of DUMMY0 and DUMMY1.
    """
    config = folder / "two-monitors.conf"
    config.write_text(TWO_MONITORS)
    command = ["Xorg", "-config", str(config), "-logfile", str(folder / "xorg.0.log")]
    with _server(command, folder / "xorg.log") as display:
        places = ("DUMMY0", first, ("0x0", "--primary")), ("DUMMY1", second, (f"{first[0]}x0",))
        for output, (width, height), place in places:
            mode, lines = f"{width}x{height}", (width, width, width, width, height, height, height, height)
            if mode not in KNOWN_MODES:
                _xrandr(display, "--newmode", mode, "25", *(str(line + 8 * (n % 4)) for n, line in enumerate(lines)))
            _xrandr(display, "--addmode", output, mode)
            _xrandr(display, "--output", output, "--mode", mode, "--pos", *place)
        _xrandr(display)  # a full query, without which GLFW reads a cached list with one monitor
        yield display


@contextmanager
def _server(command: Sequence[str], log: Path) -> Iterator[str]:
    """Run an X server that chooses its display and keeps its state when the last window closes (-noreset)."""
    if shutil.which(command[0]) is None:
        raise NoServerError(f"{command[0]} is not installed; make test installs it, counterlight doctor says how")
    readable, writable = os.pipe()
    with log.open("wb") as output:
        arguments = [*command, "-displayfd", str(writable), "-noreset", "-nolisten", "tcp"]
        server = subprocess.Popen(arguments, stdout=output, stderr=output, pass_fds=[writable])
    os.close(writable)
    try:
        yield f":{_first_line(readable, command[0], log)}"
    finally:
        os.close(readable)
        server.terminate()
        server.wait()


def _first_line(readable: int, name: str, log: Path) -> str:
    """Returns the display number, which a server writes when it is ready for clients."""
    line = b""
    while not line.endswith(b"\n"):
        ready, _, _ = select.select([readable], [], [], START_S)
        piece = os.read(readable, 16) if ready else b""
        if not piece:
            raise NoServerError(
                f"{name} did not start; as a plain user Xorg may need root. It said: {log.read_text()[-2000:]}"
            )
        line += piece
    return line.decode().strip()


def _xrandr(display: str, *arguments: str) -> None:
    command = ["xrandr", "--display", display, *arguments]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=START_S, check=False)
    if outcome.returncode:
        raise NoServerError(f"{' '.join(command)}: {outcome.stderr.strip()}")
