"""counterlight example: simulate a room, invert it, and play a film through the inverse, drawn by the shaders."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np

from counterlight import app, calibration
from counterlight.command import Parser, command_line, conclusion, verb
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.gl.probe import probe_opengl
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.room import Room, read_room
from counterlight.show.headless import FRAME_TIMEOUT_S, headless_renderer
from counterlight.show.output import write_picture
from counterlight.tools import build_correction_map, simulate_transport
from counterlight.tools.frame_rate import draw_seconds
from counterlight.tools.shipped import CLIP, parse_scene
from counterlight.writing.replacing import replacing_file

SHOWN_AT_S = 2.0
FILM_FRAMES = 48  # frames rendered without a screen; llvmpipe takes a third of a second per frame
TIMED_FRAMES = 12

EXAMPLES = (
    "counterlight example",
    "counterlight example --scene wall --folder wall-example",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    drawn_by = probe_opengl()["renderer"]  # fails first, because without OpenGL there is nothing to show
    folder = options.folder / options.scene.stem
    prepare(options.scene, folder)
    room = read_room(folder, None)
    before, after, exposed = compare(room, options.folder)
    print(f"camera view, lit pixels: PSNR {before:.1f} dB before, {after:.1f} dB after")
    print(f"before, at the exposure of the camera that matches best: {exposed:.1f} dB")
    print(f"pictures: {options.folder / 'before.png'}, {options.folder / 'after.png'}, side by side: before_after.png")
    play(folder, options.folder)
    shaders, compiled = (frame_ms(room, backend) for backend in ("gl", "cpu"))
    print(f"a frame of the film: {shaders:.1f} ms by the shaders ({drawn_by}), {compiled:.1f} ms by compiled passes")
    action = command_line("acquire", "--camera", "CAMERA", "-o", "ROOM")
    print(conclusion(f"{options.folder}: {before:.1f} dB before compensation, {after:.1f} dB after", action))


def prepare(scene: Path, folder: Path) -> None:
    """Simulate the scene if it has changed, and build its map if that is missing; folders are always complete."""
    made = folder / calibration.TOML
    if not (made.is_file() and made.stat().st_mtime > scene.stat().st_mtime):
        _or_stop(simulate_transport.main([str(scene), "-o", str(folder), "--force"]))
    if not (folder / "correction" / "manifest.toml").is_file():
        _or_stop(build_correction_map.main([str(folder)]))


def compare(room: Room, folder: Path) -> tuple[float, float, float]:
    """Write before.png, after.png and both side by side, the camera views of one frame; returns three PSNRs in dB.

    The first PSNR is of the frame without compensation, the second of the compensated frame. The third is of the first
    frame, scaled by the one factor that matches best. All are compared with the desired picture.
    """
    lit, white = room.lit, room.white
    quality, views, seen = [], [], []
    with headless_renderer("gl", room) as renderer, MediaReader.open(CLIP) as reader:
        reader.seek(SHOWN_AT_S)
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        if frame is None:
            raise InputError(f"{CLIP}: has no frame at {SHOWN_AT_S} s; install counterlight again")
        renderer.open(frame.format)
        renderer.upload(frame)
        reader.release(frame)
        for name, compensate in (("before.png", False), ("after.png", True)):
            renderer.render("camera", compensate=compensate, steps=room.default_steps)
            with replacing_file(folder / name) as temporary:
                write_picture(temporary, renderer)
            views.append(renderer.encoded())
            desired = renderer.desired()
            seen.append(renderer.linear())
            quality.append(camera_psnr(desired, seen[-1], lit, white))
    with replacing_file(folder / "before_after.png") as temporary:
        write_png(temporary, np.hstack(views))
    factor = np.sum(seen[0] * desired) / np.sum(seen[0] ** 2)
    return quality[0], quality[1], camera_psnr(desired, factor * seen[0], lit, white)


def play(room: Path, folder: Path) -> None:
    """Play the clip in a window, or without a screen render a view that is half uncompensated and half compensated."""
    arguments = [str(room), str(CLIP), "--backend", "gl"]
    try:
        from counterlight.gl.monitors import list_monitors

        list_monitors()
    except InputError as error:
        print(error)
        rendered = "--output", str(folder / "split.mp4"), "--view", "split", "--frames", str(FILM_FRAMES)
        _or_stop(app.main([*arguments, *rendered]))
        return
    print("keys: c compensation, v view, i statistics, space pause, q quit")
    _or_stop(app.main([*arguments, "--loop"]))


def frame_ms(room: Room, backend: str) -> float:
    """Returns the median milliseconds from a decoded frame to the projector picture."""
    took = list[float]()
    with headless_renderer(backend, room) as renderer, MediaReader.open(CLIP) as reader:
        renderer.open(reader.info.format)
        while len(took) < TIMED_FRAMES and (frame := reader.next_frame(FRAME_TIMEOUT_S)) is not None:
            took.append(1000 * draw_seconds(renderer, frame, room.default_steps))
            reader.release(frame)
    return median(took)


def _or_stop(code: int) -> None:
    if code:
        raise SystemExit(code)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("example", description=__doc__, examples=EXAMPLES)
    parser.add_argument(
        "--scene",
        type=parse_scene,
        default="corner",
        help="simulate this scene: a shipped one, or a file (default corner)",
    )
    parser.add_argument(
        "--folder", type=Path, default=Path("example"), help="write the room and the pictures here (default example)"
    )
    return parser
