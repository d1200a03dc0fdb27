"""The shipped scenes and clip, for trials. Imports stay light, because option parsing loads this module."""

from importlib import resources
from pathlib import Path

from counterlight.errors import InputError, nearest

DATA = Path(str(resources.files("counterlight.calib_data")))
CLIP = DATA / "media" / "big_buck_bunny.mp4"


def shipped_scenes() -> dict[str, Path]:
    """Returns the shipped scenes' files by name."""
    return {path.stem: path for path in sorted((DATA / "scenes").glob("*.toml"))}


def parse_scene(text: str) -> Path:
    """Returns a scene's file: an existing path, or the shipped scene of that name; InputError for neither."""
    path, scenes = Path(text), shipped_scenes()
    if (text and path.exists()) or path.suffix or len(path.parts) > 1:
        return path
    if text not in scenes:
        raise InputError(f"{text or 'empty name'}: no such file, no shipped scene{nearest(text, scenes)}")
    return scenes[text]
