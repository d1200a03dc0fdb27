"""Small file of each kind outside a calibration folder, with its reader, as input of damage campaigns."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from scipy import sparse

from counterlight.calibration import Device, read_mask_picture
from counterlight.files import exr
from counterlight.files.picture_files import read_picture
from counterlight.media.decoding.media import open_source
from counterlight.media.medium import Medium
from counterlight.response import Response, named_response
from counterlight.show.command_line import read_options
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.matrices_room import read_ambient
from counterlight.tools.acquisition.store import SESSION, Wanted, open_store
from counterlight.tools.hdr.grey_ramp import read_ramp
from counterlight.tools.hdr.photographs import read_photograph
from counterlight.tools.hdr.raw_files import read_exposure
from counterlight.tools.simulation.materials import read_texture
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.shapes.mesh import read_obj
from counterlight.tools.simulation.shapes.triangles import read_heights
from counterlight.tools.transport.storage import read_matrix
from tests.dng import dng
from tests.mutants import outcome
from tests.scenes import SCENES
from tests.test_simulation_shapes import CUBE

CAMERA = Device(9, 13, Response("linear"))
SHAPE = (48, 30)
SETTINGS = """
refine = 7
compensation = false
loop = true
view = "camera"
white = 0.5
image-display-duration = "inf"
brightness = -5
monitor = ["HDMI-1", 2]
screenshot-directory = "shots"
[keys]
"ctrl+x" = "quit"
"""


@dataclass(frozen=True)
class Sample:
    """File content and its reader."""

    content: bytes
    read: Callable[[Path], object]

    def outcome(self, path: Path, content: bytes) -> str:
        """Outcome of reading the file with another content."""
        path.write_bytes(content)
        return outcome(lambda: self.read(path))


def samples(folder: Path) -> dict[str, Sample]:
    """Samples by file name, made in an empty folder."""
    rng = np.random.default_rng(1)
    rgb = rng.uniform(size=(*CAMERA.shape, 3)).astype(np.float32)
    exr.write_rgb(folder / "rgb.exr", rgb)
    picture = (folder / "rgb.exr").read_bytes()
    smooth = cv2.GaussianBlur(rng.integers(0, 255, (64, 80, 3)).astype(np.uint8), (9, 9), 3)
    scenes = {
        f"{name}.toml": Sample((SCENES / f"{name}.toml").read_bytes(), load_scene) for name in ("glass", "statuette")
    }
    return {
        **scenes,
        **_matrices(folder, rng),
        "settings.toml": Sample(SETTINGS.encode(), lambda p: read_options(["room", "a.mp4", "--config", str(p)], "")),
        "response.toml": Sample(b"response = [[0, 0, 0], [0.2, 0.3, 0.4], [1, 1, 1]]", _read_response),
        "session.toml": Sample(_session(folder / "captures"), _read_session),
        "ramp.csv": Sample(
            b"level,red,green,blue\n0,0,0,0\n64,0.1,0.1,0.1\n255,1,1,0.9\n", lambda p: read_ramp(p, Response("linear"))
        ),
        "cube.obj": Sample(CUBE.encode(), lambda p: read_obj(p, "here", np.zeros(3), 1.0)),
        "ambient.npy": Sample(_saved(rgb), lambda p: read_ambient(p, CAMERA)),
        "ambient.exr": Sample(picture, lambda p: read_ambient(p, CAMERA)),
        "medium.exr": Sample(picture, lambda p: open_source(Medium.of(p), None)),
        "mask.png": Sample(_encoded(".png", rgb[..., 0] > 0.5), lambda p: read_mask_picture(p, CAMERA)),
        "deep.png": Sample(_encoded(".png", (65535 * rgb).astype(np.uint16)), read_picture),
        "heights.png": Sample(_encoded(".png", smooth[..., 0]), lambda p: read_heights(p, "here", 9, 9)),
        "capture.jpg": Sample(_encoded(".jpg", smooth), lambda p: (read_picture(p), read_exposure(p))),
        "capture.dng": Sample(
            dng(rng.integers(0, 16384, (24, 32)).astype(np.uint16), black=(512,), white=16000, exposure_s=0.25),
            lambda p: (read_photograph(p), read_exposure(p)),
        ),
        "texture.jpg": Sample(
            _encoded(".jpg", smooth, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), lambda p: read_texture(p, "here")
        ),
    }


def _matrices(folder: Path, rng: np.random.Generator) -> dict[str, Sample]:
    """Samples of each of scipy's sparse formats."""
    matrix = sparse.csr_array(sparse.random_array(SHAPE, density=0.1, rng=rng, dtype=np.float32))
    diagonals = sparse.dia_array((np.ones((3, SHAPE[1]), np.float32), [0, 1, -4]), shape=SHAPE)
    forms = matrix, matrix.tocsc(), matrix.tocoo(), matrix.tobsr((4, 5)), diagonals
    for form in forms:
        sparse.save_npz(folder / f"{form.format}.npz", form)
    names = [f"{form.format}.npz" for form in forms]
    return {name: Sample((folder / name).read_bytes(), lambda p: read_matrix(p, SHAPE)) for name in names}


def _saved(values: np.ndarray) -> bytes:
    stream = BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def _encoded(suffix: str, picture: np.ndarray, *options: int) -> bytes:
    codes = 255 * picture.astype(np.uint8) if picture.dtype == bool else picture
    return bytes(cv2.imencode(suffix, codes, options)[1].tobytes())


def _read_response(path: Path) -> None:
    response = named_response(str(path))
    assert np.isfinite(response.inverse_table()).all()
    assert np.isfinite(response.to_linear(np.linspace(0, 1, 7)[:, None] * np.ones(3))).all()


def _session(folder: Path) -> bytes:
    _begin(folder)
    return (folder / SESSION).read_bytes()


def _read_session(path: Path) -> None:
    """Read the file as a resumed acquisition does, in a folder of captures."""
    folder = path.with_suffix(".captures")
    folder.mkdir(exist_ok=True)
    shutil.copy(path, folder / SESSION)
    _begin(folder)


def _begin(folder: Path) -> None:
    with open_store(folder, {"camera": "a test"}, Exposures((0.1,)), Wanted(folder.with_name("room"))):
        pass
