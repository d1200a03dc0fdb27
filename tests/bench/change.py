"""Changes of media in a window: lateness of the frames next to a change, compared with frames between changes."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import numpy as np

from tests.programs import on, succeed
from tests.screens import one_screen

# frames per second, and a room that two cores can draw at that rate
RATES = {25: "256x192", 50: "96x72", 60: "96x72"}
SIZES = (192, 256), (180, 320)  # sizes of media; they alternate, so that formats change
# seconds per medium; number of media of each size; number of files without a picture before each medium
SECONDS, ROUNDS, BAD = 4, 2, 2
BUSY = "while True: pass"
SCREEN = 1280, 1024
REFRESH_MS = 1000 / 60


def change() -> Iterator[str]:
    """Late frames at changes of media: 256x192 at 25 fps, 96x72 at 50 and 60 fps, with bad media, idle and busy."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for size in dict.fromkeys(RATES.values()):
            succeed("simulate", "wall", "--projector", size, "--camera", size, "-o", folder / size)
            succeed("build", folder / size)
        with one_screen(folder, SCREEN) as display:
            for rate, loops in product(RATES, (0, 2)):
                with ExitStack() as stack:
                    for _ in range(loops):
                        busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", BUSY]))
                        stack.callback(busy.kill)
                    yield line(rate, loops, played(folder, folder / RATES[rate], display, rate))


def played(folder: Path, room: Path, display: str, rate: int) -> dict[str, dict[str, float]]:
    """Returns what `--stats` writes for a playlist."""
    media: list[Path] = []
    for number, size in enumerate(SIZES * ROUNDS):
        for bad in range(BAD if number else 0):
            media.append(folder / f"bad{bad}.mkv")
            media[-1].write_bytes(b"no film")
        media.append(folder / f"{size[1]}x{size[0]}-{rate}.mkv")
        if not media[-1].exists():
            write_clip(media[-1], size, rate)
    stats = folder / "stats.json"
    quiet = "--no-config", "--no-audio", "--osd", "off", "--no-vsync"
    succeed("play", room, *media, *quiet, "--stats", stats, **on(display))
    return dict(json.loads(stats.read_text()))


def line(rate: int, loops: int, found: dict[str, dict[str, float]]) -> str:
    late, at_change = found["late_ms"], found["change_ms"]
    allowed = late["p99"] + REFRESH_MS
    verdict = "in time" if at_change["max"] <= allowed else "late"
    return (
        f"{rate} fps, {loops} busy loops: at changes at most {at_change['max']:.1f} ms late (median "
        f"{at_change['median']:.1f}); between them 99 % below {late['p99']:.1f} (median {late['median']:.1f}, "
        f"at most {late['max']:.1f}); {found['dropped']} dropped: {verdict}"
    )


def write_clip(path: Path, size: tuple[int, int], rate: int) -> None:
    """Write a bright moving bar, H.264."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"preset": "veryfast"})
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = size
        stream.pix_fmt = "yuv420p"
        for index in range(rate * SECONDS):
            picture = np.full((*size, 3), 60, np.uint8)
            picture[:, 2 * index % size[1] :][:, :20] = 220
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
