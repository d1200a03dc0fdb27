"""The notebooks of docs/notebooks run from top to bottom, without Jupyter, and reach the figures that they promise."""

import re

import numpy as np
import pytest

import counterlight as cl
from tests import notebook
from tests.programs import ROOT

NOTEBOOKS = ROOT / "docs" / "notebooks"


def test_transport_is_measured_solved_and_compared() -> None:
    cells, found = notebook.run(NOTEBOOKS / "transport.ipynb")
    assert sum(len(cell.figures) for cell in cells) == 2
    assert any(re.search(r"scipy \d+\.\d\d dB, box \d+", cell.printed) for cell in cells)
    quality = {name: decibels for name, (_, decibels) in found["results"].items()}
    assert quality.keys() == {"direct", "qr", "svd", "nnls", "box", "scipy"}
    assert quality["box"] == pytest.approx(
        quality["scipy"], abs=0.1
    )  # both drives are judged in the true room, and solved in the measured room
    assert max(quality[name] for name in ("direct", "qr", "svd")) < quality["box"]
    room, target = found["room"], found["target"]
    without_noise = {name: found["decibels"](cl.solve(room, target, name).drive) for name in ("direct", "qr")}
    assert without_noise["qr"] < without_noise["direct"]  # as the notebook explains
    T, measured = found["room"].transport, found["measured"].transport
    p = np.full((*found["room"].projector, 3), 0.5)
    np.testing.assert_allclose(measured @ p, T @ p, atol=0.02 * found["room"].white)


def test_every_notebook_is_linked_from_the_page_of_python() -> None:
    page = (ROOT / "docs" / "api.md").read_text()
    assert [path.name for path in NOTEBOOKS.iterdir() if f"notebooks/{path.name}" not in page] == []
