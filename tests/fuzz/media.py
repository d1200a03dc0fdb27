"""Damaged media: small clips of many containers and codecs, pictures and sequences, through the real decoder's process.

A medium may kill a decoder. The player must survive, and report the medium in one line. Frames keep the format that
was announced.
"""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from counterlight import app
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.media.decoding.opening import log_natively
from counterlight.media.frames import MediaInfo
from counterlight.media.video import Frame, MediaReader
from counterlight.tools import build_correction_map
from tests.fuzz.tally import CRASHED, LEFT, READ, REFUSED, WRONG, Trial
from tests.fuzz.warden import Case, FileCampaign, resident_bytes
from tests.media import numbered, write_video
from tests.mutants import LONGEST_COMPLAINT, mutant
from tests.rooms import write_blurred_room

FRAMES, LAPS = 8, 2
QUIET = 0  # level of av.logging that hides FFmpeg's messages about damaged files
ROOM = "room"
CLIPS: dict[str, dict[str, Any]] = {
    "ffv1.mkv": {"codec": "ffv1"},
    "h264.mp4": {"codec": "libx264", "options": {"g": "4", "bf": "2"}},
    "h265.mkv": {"codec": "libx265", "options": {"x265-params": "log-level=none"}},
    "fragments.mp4": {"codec": "libx264", "container_options": {"movflags": "frag_keyframe+empty_moov"}},
    "vp9.webm": {"codec": "libvpx-vp9"},
    "vp8.webm": {"codec": "libvpx"},
    "mpeg2.ts": {"codec": "mpeg2video"},
    "mpeg2.mpg": {"codec": "mpeg2video"},
    "mpeg4.avi": {"codec": "mpeg4"},
    "wmv2.asf": {"codec": "wmv2"},
    "flv1.flv": {"codec": "flv"},
    "prores.mov": {"codec": "prores_ks", "pixel_format": "yuv422p10le"},
    "mjpeg.mov": {"codec": "mjpeg", "pixel_format": "yuvj420p"},
    "raw.y4m": {"codec": "wrapped_avframe"},
    "raw.nut": {"codec": "rawvideo"},
    "huffyuv.avi": {"codec": "huffyuv", "pixel_format": "yuv422p"},
    "mpeg2.mxf": {"codec": "mpeg2video"},
}
SEQUENCES = {"n%02d.png": ".png", "j%02d.jpg": ".jpg", "e%02d.exr": ".exr"}
STILLS = ".png", ".jpg", ".exr", ".tiff", ".bmp", ".webp", ".ppm", ".hdr"
HOWS = "shown", "shown", "shown", "looped", "read for a file", "rendered"


class Media(FileCampaign):
    """A mutant of a medium is shown in a loop, read as a whole for a file, or rendered into a file."""

    name, count = "media", 150
    purpose = "damaged clips, pictures and sequences through the decoder's process and counterlight play --output"

    def furnish(self, folder: Path) -> None:
        log_natively(QUIET)
        originals = folder / "originals"
        originals.mkdir()
        for name, options in CLIPS.items():
            write_video(originals / name, [_picture(n) for n in range(FRAMES)], **options)
        picture = np.random.default_rng(2).integers(0, 256, (24, 40, 3), np.uint8)
        for suffix in STILLS:
            _write_still(originals / f"still{suffix}", picture)
        write_blurred_room(folder / ROOM, np.random.default_rng(3), (24, 40), (20, 30))
        assert build_correction_map.main([str(folder / ROOM), "--regularize", "0.2"]) == 0

    def open(self, folder: Path) -> None:
        self._folder = folder
        found = sorted((folder / "originals").iterdir())
        self._originals = {path.name: path.read_bytes() for path in found}
        self._names = [*self._originals, *SEQUENCES]

    def draw(self, rng: np.random.Generator) -> Case:
        name, how = self._names[rng.integers(len(self._names))], HOWS[rng.integers(len(HOWS))]
        if name not in SEQUENCES:
            return Case({name: mutant(self._originals[name], name, rng)}, f"{name}, {how}")
        still = f"still{SEQUENCES[name]}"
        files = {name % number: self._originals[still] for number in range(3)}
        spoilt = name % int(rng.integers(3))
        return Case(files | {spoilt: mutant(files[spoilt], still, rng)}, f"{name}, {how}")

    def judge(self, case: Case) -> Trial:
        for name, content in case.files.items():
            (self._folder / name).write_bytes(content)
        name, _, how = case.how.partition(", ")
        medium = self._folder / name
        if how == "rendered":
            return self._rendered(medium)
        try:
            return _shown(medium, loop=how == "looped", tolerant=how != "read for a file")
        except InputError as error:
            return _refusal(str(error))

    def _rendered(self, medium: Path) -> Trial:
        output, errors = self._folder / "rendered%02d.png", io.StringIO()
        words = [self._folder / ROOM, medium, "--output", output, "--frames", "3", "--no-config"]
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
            code = app.main([str(word) for word in words])
        found = sorted(self._folder.glob("*rendered*"))
        pictures = [cv2.imread(str(path)) for path in found if path.is_file()]
        for path in found:
            path.unlink()
        if code == 0:
            whole = pictures and all(picture is not None for picture in pictures)
            return Trial(READ) if whole else Trial(WRONG, f"exit code 0 and {len(pictures)} pictures, not all whole")
        if found:
            return Trial(LEFT, f"exit code {code} and {[path.name for path in found]}")
        lines = [line for line in errors.getvalue().splitlines() if line.startswith("error: ")]
        if code != 2 or len(lines) != 1:
            return Trial(CRASHED, f"exit code {code}: {errors.getvalue()}")
        return _refusal(lines[0])


def _shown(medium: Path, *, loop: bool, tolerant: bool) -> Trial:
    with MediaReader.open(medium, loop=loop, tolerant=tolerant) as reader:
        try:
            return _all_frames(reader, most=LAPS * FRAMES)
        finally:
            for line in reader.notices():
                assert "\n" not in line, line


def _all_frames(reader: MediaReader, most: int) -> Trial:
    """Check that every frame has the announced format, and that times never step back."""
    last_s, peak = 0.0, 0
    for _ in range(most):
        frame = reader.next_frame(timeout_s=60.0)
        peak = max(peak, resident_bytes(reader.decoder_pid, peak=True))
        if frame is None:
            break
        wrong = _complaint(frame, reader.info, last_s)
        last_s = frame.time_s
        reader.release(frame)
        if wrong:
            return Trial(WRONG, wrong, peak=peak)
    return Trial(READ, peak=peak)


def _complaint(frame: Frame, info: MediaInfo, last_s: float) -> str:
    if frame.format != info.format:
        return f"a frame of {frame.format}, {info.format} was told"
    if not last_s <= frame.time_s < float("inf"):
        return f"a frame at {frame.time_s} s after one at {last_s} s"
    if frame.format.layout == "radiance" and not all(np.isfinite(plane).all() for plane in frame.planes):
        return "radiance that is not finite"
    return ""


def _refusal(line: str) -> Trial:
    if "\n" in line or len(line) > LONGEST_COMPLAINT:
        return Trial(CRASHED, f"no line of bounded length: {line}")
    return Trial(REFUSED, line)


def _picture(n: int) -> tuple[np.ndarray, ...]:
    return numbered(n, 48, 64)


def _write_still(path: Path, picture: np.ndarray) -> None:
    write: dict[str, Callable[[], object]] = {
        ".exr": lambda: exr.write_rgb(path, (picture / 255).astype(np.float32)),
        ".hdr": lambda: cv2.imwrite(str(path), (picture / 255).astype(np.float32)),
    }
    write.get(path.suffix, lambda: cv2.imwrite(str(path), picture))()
