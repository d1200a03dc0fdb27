"""Runs a notebook without Jupyter, for a test and for the site."""

import ast
import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib import pyplot as plt
from matplotlib.figure import Figure


@dataclass(frozen=True)
class Cell:
    """A cell after its run.

    kind : markdown or code.
    printed : what the code printed, and the last expression's value.
    figures : PNG files.
    """

    kind: str
    source: str
    printed: str = ""
    figures: tuple[bytes, ...] = ()


def run(path: Path) -> tuple[list[Cell], dict[str, Any]]:
    """Returns the cells, and the variables after the last cell."""
    matplotlib.use("Agg")
    variables: dict[str, Any] = {}
    cells = [_cell(each, variables, path.name) for each in json.loads(path.read_text())["cells"]]
    return cells, variables


def _cell(described: dict[str, Any], variables: dict[str, Any], name: str) -> Cell:
    source = "".join(described["source"])
    if described["cell_type"] != "code":
        return Cell("markdown", source)
    assert not described["outputs"], "clear the outputs before a notebook is committed"
    printed = io.StringIO()
    with redirect_stdout(printed):
        value = _value(source, f"{name}:{described['id']}", variables)
    figures = [plt.figure(number) for number in plt.get_fignums()]
    if isinstance(value, Figure):
        figures += [] if value in figures else [value]
    elif value is not None:
        print(repr(value), file=printed)
    drawn = tuple(_png(figure) for figure in figures)
    plt.close("all")
    return Cell("code", source, printed.getvalue(), drawn)


def _value(source: str, name: str, variables: dict[str, Any]) -> object:
    """Runs a cell; returns the value of its last line if this is an expression."""
    *body, last = ast.parse(source).body
    exec(compile(ast.Module(body, []), name, "exec"), variables)
    if isinstance(last, ast.Expr):
        return eval(compile(ast.Expression(last.value), name, "eval"), variables)
    exec(compile(ast.Module([last], []), name, "exec"), variables)
    return None


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=100, bbox_inches="tight")
    return file.getvalue()


def markdown(path: Path) -> Iterator[tuple[str, str | bytes]]:
    """Yields the page of a notebook and its figures: file name -> content."""
    parts, count = [], 0
    for cell in run(path)[0]:
        parts.append(cell.source if cell.kind == "markdown" else f"```python\n{cell.source}\n```")
        if cell.printed:
            parts.append(f"```\n{cell.printed.rstrip()}\n```")
        for figure in cell.figures:
            count += 1
            yield f"{path.stem}_{count}.png", figure
            parts.append(f"![Figure {count}]({path.stem}_{count}.png)")
    yield f"{path.stem}.md", "\n\n".join(parts) + "\n"
