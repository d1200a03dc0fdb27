"""A clip in a window: the real player under Xvfb, 1280x720 through a Gray-code calibration of a 1024x768 projector.

The captures are rendered: a camera of 1280x1024 in front of a textured wall. If the shared data are next to the
checkout, real captures of the same sizes follow.
"""

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import av
import cv2
import numpy as np

from counterlight.media.video import MediaReader
from counterlight.pipeline.room import read_room
from counterlight.show.headless import headless_renderer
from tests.bench.rows import WARM_UP
from tests.programs import on, succeed
from tests.screens import one_screen
from tests.test_graycode import SHARED, opencv_code, write_capture

PROJECTOR, CAMERA = (768, 1024), (1024, 1280)
FRAME, RATE, SECONDS = (720, 1280), 30, 6
FEW, DRAWN = 60, 20  # FEW: frames at a slower rate; DRAWN: frames that are drawn alone
SCREEN = 1280, 1024
REAL = SHARED / "graycode-procam-kamino" / "capture_0"
GOAL_MS = 5.0  # milliseconds to decode and upload a frame
ALLOWED = 0.8  # share of a frame's time that drawing may take, so that the frame is ready in time
PATIENCE_S = 600.0


def show() -> Iterator[str]:
    """A 720p clip in a window through a Gray-code calibration: drops, judder, decode and upload, drawing."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_clip(folder / "clip.mp4")
        yield f"decoding alone: {decoding_ms(folder / 'clip.mp4'):.1f} ms of processor time a frame"
        write_captures(folder / "rendered")
        captures = {"rendered captures": folder / "rendered", "real captures": REAL}
        with one_screen(folder, SCREEN) as display:
            for what, source in captures.items():
                if source.is_dir():
                    yield f"{what}, {make_room(source, folder / what)}:"
                    spent = drawing_ms(folder / what, folder / "clip.mp4")
                    yield f"  drawing alone: {spent:.0f} ms of processor time a frame, all cores together"
                    yield from play(display, folder / what, folder / "clip.mp4")


def play(display: str, room: Path, clip: Path) -> Iterator[str]:
    """Play at the clip's rate, at the fastest rate that drawing allows if it is lower, and with refinement."""
    plain = "--refine", "0"
    found = stats_of(display, room, clip, *plain)
    yield line("--refine 0", found, 1.0)
    speed = min(1.0, ALLOWED * 1000 / RATE / (found["gpu_ms"]["p95"] + found["present_ms"]["p95"]))
    if speed < 1:
        slower = stats_of(display, room, clip, *plain, "--speed", f"{max(speed, 0.01):.3f}", "--frames", str(FEW))
        yield line("--refine 0", slower, speed)
    yield line("4 steps", stats_of(display, room, clip), 1.0)


def line(what: str, found: dict[str, Any], speed: float) -> str:
    stage = {name: found[f"{name}_ms"]["median"] for name in ("decode", "upload", "gpu", "present", "judder")}
    drawing, frame_ms = stage["gpu"] + stage["present"], 1000 / RATE / speed
    allows = "allowed" if drawing <= ALLOWED * frame_ms else "not allowed"
    return (
        f"  {what:<10} {RATE * speed:4.1f} fps: {found['frames']} frames, {found['dropped']} dropped, "
        f"judder {stage['judder']:.1f} ms (95 % below {found['judder_ms']['p95']:.1f}); "
        f"decode {stage['decode']:.1f} + upload {stage['upload']:.1f} ms (goal {GOAL_MS:g}); "
        f"draw {stage['gpu']:.1f} + present {stage['present']:.1f} ms of {frame_ms:.1f}: {allows}"
    )


def drawing_ms(room: Path, clip: Path) -> float:
    """Returns the processor time of all threads to draw a frame without refinement, which other load hardly changes."""
    # the same choice of the backend as for a window
    made = headless_renderer("auto", read_room(room, None, refinement=False))
    with made as renderer, MediaReader.open(clip) as reader:
        renderer.open(reader.info.format)
        frame = reader.next_frame(PATIENCE_S)
        assert frame is not None
        renderer.upload(frame)
        spent = []
        for _ in range(WARM_UP + DRAWN):
            before = time.process_time()
            renderer.render("projector", compensate=True)
            renderer.finish()
            spent.append(time.process_time() - before)
    return 1000 * float(np.median(spent[WARM_UP:]))


def decoding_ms(clip: Path) -> float:
    """Returns the decoder process's time per frame over all cores, including the copy into shared memory."""
    with MediaReader.open(clip) as reader:
        before, frames = processor_s(reader.decoder_pid), 0
        while (frame := reader.next_frame(PATIENCE_S)) is not None:
            reader.release(frame)
            frames += 1
        return 1000 * (processor_s(reader.decoder_pid) - before) / frames


def processor_s(pid: int) -> float:
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def stats_of(display: str, room: Path, clip: Path, *options: str) -> dict[str, Any]:
    """Returns what `--stats` writes for the whole clip."""
    path = room.with_suffix(".json")
    quiet = "--no-config", "--no-audio", "--osd", "off"
    succeed("play", room, clip, *quiet, *options, "--stats", path, **on(display))
    return dict(json.loads(path.read_text()))


def make_room(captures: Path, room: Path) -> str:
    """Make a calibration with its maps by the commands; returns the import's summary."""
    size = f"{PROJECTOR[1]}x{PROJECTOR[0]}"
    imported = succeed("import-graycode", captures, "--projector", size, "-o", room)
    succeed("build", room)
    return imported.partition(": ")[2].strip()


def write_clip(path: Path) -> None:
    """Write a gliding textured picture, H.264."""
    height, width = FRAME
    rng = np.random.default_rng(3)
    noise = rng.uniform(0, 255, (height // 8, width // 8, 3))
    wall = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC) + rng.normal(0, 6, (*FRAME, 3))
    picture = wall.clip(0, 255).astype(np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE, options={"preset": "veryfast"})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for index in range(RATE * SECONDS):
            shown = np.roll(picture, (index, 3 * index), axis=(0, 1))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(shown, format="rgb24")))
        container.mux(stream.encode(None))


def write_captures(folder: Path) -> None:
    """Write OpenCV's patterns on an obliquely seen wall: up to 190 codes of light over 10 of ambient."""
    folder.mkdir()
    rng = np.random.default_rng(4)
    height, width = PROJECTOR
    seen = np.array([[90, 60], [1190, 20], [1240, 960], [40, 1000]], np.float32)
    H = cv2.getPerspectiveTransform(np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32), seen)
    albedo = rng.uniform(0.4, 1, CAMERA)
    for number, pattern in enumerate(opencv_code(PROJECTOR)[1]):
        lit = cv2.warpPerspective(pattern, H, CAMERA[::-1], flags=cv2.INTER_NEAREST) / 255
        light = 10 + 190 * albedo * lit + rng.normal(0, 1, CAMERA)
        write_capture(folder / f"shot{number}.png", light.round().clip(0, 255).astype(np.uint8))
