"""Watches a projector's pixels as the audience does, 30 times a second, and flags pictures that no audience may see.

The desktop is magenta and the films are flat green. A pixel of the desktop, a window decoration or a letter is
therefore neither black nor the films' green.
"""

import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Self

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import sparse
from Xlib import X
from Xlib.display import Display
from Xlib.error import BadMatch

from counterlight.calibration import Calibration, Device, writing
from counterlight.response import Response
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport
from tests import screens
from tests.programs import PATIENCE_S, children, on, wait_until

PROJECTOR = 256, 192  # (width, height) of DUMMY1, to the right of the desk
BOX = 1280, 0, *PROJECTOR
MANAGERS = "none", "openbox", "metacity", "icewm"
PER_S = 30
LEVELS = {"dark": 90, "bright": 180}  # codes of the films' green
BETWEEN = 20, 130  # codes of green that separate black from dark, and dark from bright
DITHER = 4  # codes by which a flat picture may vary
MOST_SAVED = 5
PLAYER, CURTAIN = b"counterlight.app", b"counterlight.gl.curtain"
ALWAYS = 'format = 1\n[[hours]]\nfrom = "00:00"\nto = "00:00"\n'
SILENT = "--no-audio", "--no-config"
DESKTOP = "#ff00ff"


class Audience:
    """Thread that grabs the projector's pixels and names each picture.

    seen : names from `name_of`, in order, without repeats; "" while the monitor is off.
    since_s : start of each entry of `seen`, in seconds.
    composited : the window manager draws the desktop before the windows when a monitor comes back.
    """

    def __init__(self, display: str, folder: Path, *, composited: bool = False) -> None:
        self._connection, self._folder, self._composited = Display(display), folder, composited
        self._closed = threading.Event()
        self.seen: list[str] = []
        self.since_s: list[float] = []
        self.pictures = 0
        self.leaks: list[str] = []
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    @property
    def now(self) -> str:
        return self.seen[-1] if self.seen else ""

    def leaves(self) -> None:
        """Wait until the audience sees the whole desktop, with nothing left of the show."""
        deadline = time.monotonic() + PATIENCE_S
        while self.now != "desktop":
            assert time.monotonic() < deadline, self.seen[-9:]
            time.sleep(1 / PER_S)

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self._connection.close()

    def _watch(self) -> None:
        began, data, picture, name = time.monotonic(), b"", np.zeros((0, 0, 3), np.uint8), ""
        while not self._closed.wait(max(0.0, began + self.pictures / PER_S - time.monotonic())):
            self.pictures += 1
            try:
                found = self._connection.screen().root.get_image(*BOX, X.ZPixmap, 0xFFFFFFFF)
            except BadMatch:  # the monitor is off, so the desktop ends before it
                self._told("")
                continue
            if found.data != data:  # the same bytes have the same name
                data, picture = found.data, np.frombuffer(found.data, np.uint8).reshape(*PROJECTOR[::-1], 4)[..., 2::-1]
                name = name_of(picture)
            self._judge(picture, name)

    def _judge(self, picture: NDArray[np.uint8], name: str) -> None:
        """Record a picture, (height, width, 3) RGB codes, and save the first leaks as PNG files."""
        if self._composited and self.seen and self.now == "" and name in ("desktop", "leak"):
            return  # metacity's compositor shows the desktop for one or two pictures when a monitor comes back
        self._told(name)
        if name == "leak":
            self.leaks.append(f"picture {self.pictures}, after {self.seen[-3:-1]}")
            if len(self.leaks) <= MOST_SAVED:
                Image.fromarray(picture).save(self._folder / f"leak-{len(self.leaks)}.png")

    def _told(self, name: str) -> None:
        if name != self.now:
            self.since_s.append(time.monotonic())
            self.seen.append(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Evening:
    """Supervised show of two films and its audience."""

    def __init__(self, process: subprocess.Popen[str], audience: Audience) -> None:
        self.process, self.audience = process, audience

    def sees(self, *names: str) -> None:
        """Wait until the audience has seen these pictures in this order, from now on."""
        for name in names:
            wait_until(lambda n=name: self.audience.now == n, f"{name}: {self.audience.seen[-9:]}", self.process)

    def child(self, module: bytes, *, other_than: int = 0) -> int:
        """Wait for the process of the player or the curtain and return its id."""
        found: list[int] = []

        def starts() -> bool:
            found[:] = [pid for pid in children(self.process.pid) if pid != other_than and runs(pid, module)]
            return bool(found)

        wait_until(starts, module.decode(), self.process)
        return found[0]


def runs(pid: int, module: bytes) -> bool:
    try:
        return module in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def closed_hours() -> str:
    today = datetime.now().date()
    return f"closed = [{', '.join(repr(str(today + timedelta(days=n))) for n in range(-2, 3))}]\n{ALWAYS}"


def change(path: Path, text: str) -> None:
    path.with_suffix(".new").write_text(text)
    path.with_suffix(".new").rename(path)


def name_of(picture: NDArray[np.uint8]) -> str:
    """Returns "desktop", "black", "dark", "bright", or "leak" for a picture that no audience may see."""
    if (picture == (255, 0, 255)).all():
        return "desktop"
    levels = picture[..., 1]
    if picture[..., ::2].max() > DITHER or np.ptp(levels) > DITHER:
        return "leak"
    return ("black", *LEVELS)[sum(int(levels.max()) > edge for edge in BETWEEN)]


def write_room(folder: Path) -> None:
    """Write the calibration of a grey wall: the camera sees the picture of projector DUMMY1 pixel by pixel."""
    shape = PROJECTOR[::-1]
    pixels, device = shape[0] * shape[1], Device(*shape, Response("srgb"))
    projector = replace(device, monitor="DUMMY1")
    T = sparse.csr_array(sparse.diags_array(np.ones(pixels, np.float32)))
    ambient, mask = np.zeros((*shape, 3), np.float32), np.ones(shape, bool)
    with writing(folder, Calibration("grey wall", "made by a test", (projector,), device, ambient, mask)) as stage:
        write_transport(Transport.from_matrices((T, T, T)), stage)


def write_films(folder: Path, frames: int) -> list[Path]:
    """Write one flat film per level."""
    return [write_film(folder / f"{name}.mkv", [level] * frames) for name, level in LEVELS.items()]


def write_film(path: Path, levels: list[int]) -> Path:
    """Write a film of flat frames, one per level of green."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "bgr0"
        for level in levels:
            picture = np.full((48, 64, 3), (0, level, 0), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    return path


@contextmanager
def theatre(folder: Path, manager: str) -> Iterator[str]:
    """Start a magenta desktop of two monitors (desk, projector) under a window manager; yield its DISPLAY."""
    with ExitStack() as stack:
        display = stack.enter_context(screens.two_monitors(folder, second=PROJECTOR))
        subprocess.run(["xsetroot", "-solid", DESKTOP], check=True, env=_alone(display, folder))
        if manager != "none":
            stack.enter_context(managed(display, folder, manager))
        yield display


@contextmanager
def managed(display: str, folder: Path, manager: str) -> Iterator[subprocess.Popen[Any]]:
    """Start a window manager, wait until it is ready, and kill it at the end."""
    program, *_ = command = manager.split()
    assert shutil.which(program), f"{program} is not installed; make test installs it, counterlight doctor says how"
    with (folder / f"{program}.log").open("ab") as log:
        process = subprocess.Popen(command, env=_alone(display, folder), stdout=log, stderr=log)
    try:
        connection = Display(display)
        root, check = connection.screen().root, connection.intern_atom("_NET_SUPPORTING_WM_CHECK")
        deadline = time.monotonic() + PATIENCE_S
        while not _stands(connection, root, check):
            assert process.poll() is None, (folder / f"{program}.log").read_text()
            assert time.monotonic() < deadline, f"{manager} does not begin"
            time.sleep(0.02)
        connection.close()
        yield process
    finally:
        process.kill()
        process.wait()


def _stands(connection: Display, root: Any, check: int) -> bool:
    """Whether a live window manager owns the root window: its check window names itself."""
    named = root.get_full_property(check, X.AnyPropertyType)
    if named is None:
        return False
    window = connection.create_resource_object("window", named.value[0])
    try:
        itself = window.get_full_property(check, X.AnyPropertyType)
    except Exception:  # the window manager has died
        return False
    return itself is not None and itself.value[0] == named.value[0]


def _alone(display: str, folder: Path) -> dict[str, str]:
    """Environment without user settings."""
    return {"HOME": str(folder), "PATH": "/usr/bin:/bin", "XDG_RUNTIME_DIR": str(folder), **on(display)}
