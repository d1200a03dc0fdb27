"""python -m tests.bench.watching: the processor time of the watcher, in real time.

A player is imitated: it sends the light of 24 frames per second, and bursts of pictures. A program puts captures of
1280x720 pixels into a folder, 5 per second. The watcher's processor time is read from /proc, also of decoding PNG.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path
from queue import Empty

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.passes.encode import encoded
from counterlight.pipeline.shown_copies import factor_of, reduced_boxes, reduced_shape
from counterlight.show.watching import Bursts
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.registration import random_field
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.watching.view import repeating
from counterlight.unattended.watch_link import Answer, Light, Picture
from tests.oracles.formulas import grid_means
from tests.programs import here
from tests.test_watching_process import watching

CAMERA, PROJECTOR = "1280x720", "960x540"
FRAMES_PER_S, CAPTURES_PER_S, LOOP_S, LATENCY_S = 24, 5, 6, 0.07


def film(shape: tuple[int, int]) -> list[NDArray[np.float16]]:
    """Return reduced pictures of a loop: random fields that fade into the next one during half of each second."""
    fields = [np.stack([random_field(shape, 3 * n + k) for k in range(3)], axis=2) for n in range(LOOP_S)]
    frames = []
    for number in range(LOOP_S * FRAMES_PER_S):
        second, frame = divmod(number, FRAMES_PER_S)
        share = max(2 * frame / FRAMES_PER_S - 1, 0)
        mixed = (1 - share) * fields[second] + share * fields[(second + 1) % LOOP_S]
        frames.append((0.9 * mixed).astype(np.float16))
    return frames


def captures(
    room: calibration.Calibration, folder: Path, frames: list[NDArray[np.float16]], factor: int
) -> list[bytes]:
    """Return files of what a camera sees of the frames at the times of the captures."""
    settings = CameraSettings(Sensor(bits=8, full_well=20_000), response=room.camera.response)
    camera, R = SimulatedCamera(simulated_rooms(folder)[0], settings), repeating(room, factor)
    found = []
    for number in range(LOOP_S * CAPTURES_PER_S):
        drive = frames[number * FRAMES_PER_S // CAPTURES_PER_S].reshape(-1, 3).astype(np.float64)
        camera.screen.show(encoded((R @ drive).reshape(*room.projector.shape, 3), room.response))
        camera.device.expose(camera.exposures.shortest)
        shot = camera.device.frame()
        found.append(cv2.imencode(".png", shot[..., ::-1], (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes())
    return found


def used_s(process: int) -> float:
    """Return the processor time of a process so far."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser("python -m tests.bench.watching", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="seconds to measure (60)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the room here, for later runs")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        room = (options.keep or Path(temporary)) / "room"
        if not room.exists():
            here("simulate", "wall", "-o", room, "--camera", CAMERA, "--projector", PROJECTOR)
        measure(calibration.read(room), Path(temporary), options.seconds)


def measure(stored: calibration.StoredCalibration, folder: Path, seconds: float) -> None:
    factor = factor_of(stored.calibration.projector.width)
    frames = film(reduced_shape(reduced_boxes(stored.calibration.regions, factor)))
    files = captures(stored.calibration, stored.folder, frames, factor)
    grids = [grid_means(frame) for frame in frames]
    (photographs := folder / "captures").mkdir()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the player sets this when it starts the watcher
    with watching(stored, f"folder:{photographs}", folder, factor=factor) as watched:
        begun_s, begin, answer = time.monotonic(), (0.0, 0.0, 0), Answer("starting")
        taken, bursts = 0, Bursts()
        for number in range(10**9):
            now_s = begun_s + number / FRAMES_PER_S
            time.sleep(max(now_s - time.monotonic(), 0))
            watched.send(Light(now_s, grids[number % len(frames)]))
            if bursts.takes(now_s):
                watched.send(Picture(now_s, frames[number % len(frames)]))
            while begun_s + taken / CAPTURES_PER_S + LATENCY_S < time.monotonic():
                (photographs / ".new.png").write_bytes(files[taken % len(files)])
                (photographs / ".new.png").rename(photographs / f"{taken:07}.png")
                (photographs / f"{taken - 3:07}.png").unlink(missing_ok=True)
                taken += 1
            try:
                answer = watched.answers.get_nowait()
            except Empty:
                continue
            bursts.exposes = answer.exposes
            if answer.state == "holding" and not begin[0]:
                begin = time.monotonic(), used_s(watched.process), answer.captures
            if begin[0] and time.monotonic() - begin[0] > seconds:
                break
        wall_s, spent_s = time.monotonic() - begin[0], used_s(watched.process) - begin[1]
        compared = (answer.captures - begin[2]) / wall_s
        print(f"camera {CAMERA}, projector {PROJECTOR}, {CAPTURES_PER_S} captures per second, {wall_s:.0f} s:")
        print(f"{spent_s / wall_s:.1%} of a core, {compared:.1f} comparisons per second, {answer.state}")


if __name__ == "__main__":
    main()
