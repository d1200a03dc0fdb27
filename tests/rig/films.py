"""Films for a camera that watches: the shipped clip, and synthetic films that are dark, cut, fade or stand still."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

RATE = 24
SRGB = 13  # AVCOL_TRC_IEC61966_2_1
SECONDS = 20
CLIP = Path(__file__).parents[2] / "calib_data" / "media" / "big_buck_bunny.mp4"
Codes = NDArray[np.uint8]
Size = tuple[int, int]  # (width, height)


@dataclass(frozen=True)
class Film:
    """A film. frames : (count, height, width, 3), sRGB codes."""

    name: str
    frames: Codes

    def write(self, path: Path) -> Path:
        """Write the film without loss."""
        with av.open(str(path), "w") as container:
            stream = container.add_stream("ffv1", rate=RATE)
            stream.height, stream.width = self.frames.shape[1:3]
            stream.pix_fmt = "bgr0"
            stream.codec_context.color_trc = SRGB  # as in the stills; players decode untagged films with BT.1886
            for codes in self.frames:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(codes), "rgb24")))
            container.mux(stream.encode(None))
        return path

    def still(self, path: Path, frame: int) -> Path:
        """Write one frame as a picture."""
        assert cv2.imwrite(str(path), np.ascontiguousarray(self.frames[frame][..., ::-1])), path
        return path


def clip(size: Size) -> Film:
    frames = []
    with av.open(str(CLIP)) as container:
        for frame in container.decode(video=0):
            frames.append(cv2.resize(frame.to_ndarray(format="rgb24"), size, interpolation=cv2.INTER_AREA))
            if len(frames) == SECONDS * RATE:
                break
    return Film("clip", np.stack(frames))


def static(size: Size) -> Film:
    return Film("static", np.repeat(_moved(_scene(size, 0), size, 0)[None], RATE, axis=0))


def dark(size: Size) -> Film:
    """A scene that moves slowly, at a twentieth of the usual light."""
    frames = [_moved(_scene(size, 1), size, index / 4) for index in range(SECONDS * RATE)]
    return Film("dark", np.stack([np.rint(0.26 * each).astype(np.uint8) for each in frames]))


def cuts(size: Size) -> Film:
    """A cut every two seconds; scenes move by two pixels per frame."""
    frames = [
        _moved(_scene(size, index // (2 * RATE)), size, 2 * (index % (2 * RATE))) for index in range(SECONDS * RATE)
    ]
    return Film("cuts", np.stack(frames))


def fades(size: Size) -> Film:
    """Scenes that fade from and to black, five seconds each."""
    long, frames = 5 * RATE, []
    for index in range(SECONDS * RATE):
        level = min(1.0, 4 * min(index % long, long - index % long) / long)
        frames.append(np.rint(level * _moved(_scene(size, index // long), size, index % long)).astype(np.uint8))
    return Film("fades", np.stack(frames))


FILMS: dict[str, Callable[[Size], Film]] = {each.__name__: each for each in (clip, static, dark, cuts, fades)}


def _scene(size: Size, number: int) -> Codes:
    """Return a photograph that is a quarter wider than the film."""
    photograph = (data.coffee, data.chelsea, data.astronaut, data.rocket)[number % 4]()
    width, height = size[0] * 5 // 4, size[1]
    rows = photograph.shape[1] * height // width
    top = (photograph.shape[0] - rows) // 2
    cut = photograph[max(top, 0) : max(top, 0) + rows]
    soft = cv2.GaussianBlur(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), (0, 0), 1.0)
    return np.asarray(soft, np.uint8)


def _moved(scene: Codes, size: Size, pixels: float) -> Codes:
    left = round(pixels) % (scene.shape[1] - size[0] + 1)
    return np.asarray(scene[:, left : left + size[0]])
