"""Pictures and maps side by side, as a matplotlib figure. matplotlib is an extra and is imported when it draws."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT_IN, MOST_COLUMNS = 3.0, 2
CAP_PERCENTILE = 99  # few bright pixels must not hide the others
DPI = 110


def panels(title: str, pictures: Mapping[str, NDArray[np.generic]]) -> Figure:
    """Draw pictures under their names.

    pictures : (height, width, 3) code values from 0 to 1, or (height, width) a map, which gets a colour bar. Maps with
        negative values are drawn around 0. Colours end at the 99th percentile.

    Raises InputError if matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError(
            "plot draws with matplotlib, which is not installed; install it with: pip install 'counterlight[study]'"
        ) from None

    class Drawn(Figure):
        """A figure that notebooks show without pyplot."""

        def _repr_png_(self) -> bytes:
            picture = io.BytesIO()
            self.savefig(picture, format="png", dpi=DPI)
            return picture.getvalue()

    columns = min(len(pictures), MOST_COLUMNS)
    rows = -(-len(pictures) // columns)
    shape = next(iter(pictures.values())).shape
    width = max(min(HEIGHT_IN * shape[1] / shape[0], 2 * HEIGHT_IN), HEIGHT_IN) + 1
    figure = Drawn(figsize=(width * columns, (HEIGHT_IN + 0.4) * rows + 0.4), layout="constrained")
    figure.suptitle(title)
    for axes, (name, picture) in zip(
        figure.subplots(rows, columns, squeeze=False).flat, pictures.items(), strict=False
    ):
        axes.set_title(name, fontsize="medium")
        if picture.ndim == 3:
            axes.imshow(picture, interpolation="nearest")
            continue
        values = picture.astype(np.float64)
        cap = float(np.percentile(np.abs(values), CAP_PERCENTILE)) or float(np.abs(values).max()) or 1.0
        signed = bool((values < 0).any())
        low, colours = (-cap, "RdBu_r") if signed else (0.0, "viridis")
        image = axes.imshow(values, cmap=colours, vmin=low, vmax=cap, interpolation="nearest")
        figure.colorbar(image, ax=axes)
    for unused in figure.axes[len(pictures) : rows * columns]:
        unused.remove()
    return figure
