"""What is shipped to try things on: scenes by name, and a clip. Nothing here is heavy: options are parsed with it."""

from importlib import resources
from pathlib import Path

from counterlight.errors import InputError, nearest

DATA = Path(str(resources.files("counterlight.calib_data")))
CLIP = DATA / "media" / "big_buck_bunny.mp4"


def shipped_scenes() -> dict[str, Path]:
    """The shipped scenes' files by name."""
    return {path.stem: path for path in sorted((DATA / "scenes").glob("*.toml"))}


def parse_scene(text: str) -> Path:
    """A scene's file: the one that is named, or else the shipped one of that name; InputError for neither."""
    path, scenes = Path(text), shipped_scenes()
    if (text and path.exists()) or path.suffix or len(path.parts) > 1:
        return path
    if text not in scenes:
        raise InputError(f"{text or 'empty name'}: no such file, no shipped scene{nearest(text, scenes)}")
    return scenes[text]
