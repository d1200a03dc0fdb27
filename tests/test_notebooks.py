"""The notebooks of docs/notebooks run from top to bottom, without Jupyter, and reach the figures that they promise."""

import json
from typing import Any

import matplotlib
import numpy as np
import pytest

from tests.programs import ROOT

NOTEBOOKS = ROOT / "docs" / "notebooks"


def executed(name: str) -> dict[str, Any]:
    """Returns the variables after the last code cell."""
    matplotlib.use("Agg")
    cells = json.loads((NOTEBOOKS / name).read_text())["cells"]
    variables: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "clear the outputs before a notebook is committed"
            exec(compile("".join(cell["source"]), f"{name}:{cell['id']}", "exec"), variables)
    variables["plt"].close("all")
    return variables


def test_transport_is_measured_solved_and_compared(capsys: pytest.CaptureFixture[str]) -> None:
    found = executed("transport.ipynb")
    quality = {name: decibels for name, (_, decibels) in found["results"].items()}
    assert quality.keys() == {"direct", "qr", "svd", "nnls", "box", "scipy"}
    assert quality["box"] == pytest.approx(
        quality["scipy"], abs=0.1
    )  # judged in the true room, both solved in the measured one
    assert max(quality[name] for name in ("direct", "qr", "svd")) < quality["box"]
    T, measured = found["room"].transport, found["measured"].transport
    p = np.full((*found["room"].projector, 3), 0.5)
    np.testing.assert_allclose(measured @ p, T @ p, atol=0.02 * found["room"].white)
    assert "scipy" in capsys.readouterr().out


def test_every_notebook_is_linked_from_the_page_of_python() -> None:
    page = (ROOT / "docs" / "api.md").read_text()
    assert [path.name for path in NOTEBOOKS.iterdir() if f"notebooks/{path.name}" not in page] == []
