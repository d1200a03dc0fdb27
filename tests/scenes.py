"""Scenes for tests: small versions of the shipped scenes, and simple scenes from text."""

from pathlib import Path

from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram

SCENES = Path(__file__).resolve().parents[1] / "calib_data" / "scenes"


def small(name: str, camera: tuple[int, int] = (27, 48), projector: tuple[int, int] = (24, 40)) -> Scene:
    return load_scene(SCENES / f"{name}.toml").resized(camera, projector)


def scene_file(tmp_path: Path, surfaces: str, **changes: str) -> Path:
    """Write a scene of given surfaces before a projector and a camera on the z axis."""
    text = f"""
        [projector]
        width = 16
        height = 12
        position = [0, 0, 2]
        look_at = [0, 0, 0]
        horizontal_field_of_view_deg = {changes.get("fov", "30")}
        {changes.get("projector", "")}
        [camera]
        width = 20
        height = 14
        position = [0, 0, 2]
        look_at = [0, 0, 0]
        horizontal_field_of_view_deg = 20
        {changes.get("camera", "")}
        {surfaces}
    """
    path = tmp_path / "scene.toml"
    path.write_text("\n".join(line.strip() for line in text.splitlines()))
    return path


def plane(z: float = 0.0, tilt: float = 0.0, extra: str = "albedo = [0.5, 0.6, 0.7]") -> str:
    return f"""
        [[surfaces]]
        name = "plane"
        corner = [-3, -3, {z - 3 * tilt}]
        edge_u = [6, 0, {6 * tilt}]
        edge_v = [0, 6, 0]
        {extra}
    """


def rectangle(corner: list[float], edge_u: list[float], edge_v: list[float], albedo: float = 0.5) -> str:
    colour = [albedo] * 3
    return f"[[surfaces]]\ncorner = {corner}\nedge_u = {edge_u}\nedge_v = {edge_v}\nalbedo = {colour}\n"


def flat(scene: Scene, index: int) -> Parallelogram:
    shape = scene.surfaces[index].shape
    assert isinstance(shape, Parallelogram)
    return shape
