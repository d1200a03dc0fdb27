"""Rows of pictures in the camera's view: what a decibel looks like; counterparts of the thesis' Figures 5.2, 6.1."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.content import psnr
from counterlight.response import Response
from counterlight.tools.relighting.pictures import encoded
from counterlight.tools.study.measure import OURS_LABEL, THESIS_LABEL, RoomFigures
from counterlight.tools.study.plots import save, subplots

WORST = 0.25  # share of white; larger errors are drawn in the brightest colour
LOWEST_SHARE = 0.25  # share of the grey scale that Figure 5.2 stretches to the full scale
COLUMNS = {
    "desired": "desired",
    "uncompensated": "uncompensated",
    "direct": "direct mapping",
    THESIS_LABEL: "thesis: plain T⁺, cut, clamped",
    OURS_LABEL: "ours, all defaults",
}


def sheet(path: Path, room: RoomFigures) -> str:
    """Draw every kept picture of a room: a row of views, and their errors below; returns the file's name."""
    names = [name for name in COLUMNS if all(name in views for views in room.seen.values())]
    figure, grid = subplots(2 * len(room.seen), len(names), room.mask.shape)
    for index, views in enumerate(room.seen.values()):
        for column, name in enumerate(names):
            top, below = grid[2 * index, column], grid[2 * index + 1, column]
            _show(top, views[name], _title(COLUMNS[name], views, name, room.mask))
            if name == "desired":
                below.axis("off")
            else:
                heat = _heat(below, views[name] - views["desired"], room.mask)
    bar = figure.colorbar(heat, cax=grid[1, 0].inset_axes((0.8, 0.05, 0.06, 0.9)), location="left")
    bar.set_label("error, share of white", fontsize=8)
    return save(path, figure)


def figure_5_2(path: Path, room: RoomFigures) -> str:
    """Draw a picture by NNLS and by T⁺ in the player, in colour and grey, and the lowest quarter of the difference."""
    views = next(iter(room.seen.values()))
    names = {"NNLS": "NNLS", THESIS_LABEL: "plain T⁺, cut, in the player", OURS_LABEL: "ours in the player"}
    figure, grid = subplots(3, len(names), room.mask.shape)
    for column, (name, words) in enumerate(names.items()):
        _show(grid[0, column], views[name], _title(words, views, name, room.mask))
        grid[1, column].imshow(_grey(views[name]), cmap="gray", vmin=0, vmax=1)
        difference = np.abs(_grey(views[name]) - _grey(views["NNLS"]))
        grid[2, column].imshow(difference, cmap="gray", vmin=0, vmax=LOWEST_SHARE)
        grid[2, column].set_title("" if name == "NNLS" else "|difference to NNLS|, lowest quarter", fontsize=8)
    grid[2, 0].clear()
    for axes in grid.ravel():
        axes.axis("off")
    return save(path, figure)


def figure_6_1(path: Path, room: RoomFigures) -> str:
    """Draw the direct and the global approach on one wall: the whole picture, and a third of it in detail."""
    views = next(iter(room.seen.values()))
    names = [name for name in COLUMNS if name in views]
    height, width = room.mask.shape
    detail = slice(height // 4, height // 4 + height // 3), slice(width // 3, width // 3 + width // 3)
    figure, grid = subplots(2, len(names), room.mask.shape)
    for column, name in enumerate(names):
        _show(grid[0, column], views[name], _title(COLUMNS[name], views, name, room.mask))
        _show(grid[1, column], views[name][detail], "")
    return save(path, figure)


def _title(words: str, views: dict[str, FloatArray], name: str, mask: NDArray[np.bool_]) -> str:
    if name == "desired":
        return words
    return f"{words}\n{psnr(float(np.mean((views[name] - views['desired'])[mask] ** 2))):.1f} dB"


def _show(axes: Axes, linear: FloatArray, title: str) -> None:
    axes.imshow(encoded(linear, 1.0), interpolation="nearest")
    axes.set_title(title, fontsize=8)
    axes.axis("off")


def _heat(axes: Axes, error: FloatArray, mask: NDArray[np.bool_]) -> AxesImage:
    """Draw the largest error of the channels; pixels that do not count stay blank."""
    worst = np.where(mask, np.abs(error).max(axis=2), np.nan)
    axes.axis("off")
    return axes.imshow(worst, cmap="inferno", vmin=0, vmax=WORST, interpolation="nearest")


def _grey(linear: FloatArray) -> FloatArray:
    """Returns luminance as sRGB code values 0..1, because a person looks at the differences."""
    light = np.clip(linear @ np.array(LUMINANCE), 0, 1)
    codes = Response("srgb").inverse_table()[:, 0]
    return np.asarray(np.interp(np.sqrt(light), np.linspace(0, 1, codes.size), codes))
