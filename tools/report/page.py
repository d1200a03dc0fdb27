"""The page: plain HTML and CSS without external resources, dark or light as the reader's screen."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from html import escape
from importlib import metadata
from pathlib import Path

from counterlight.errors import printable

STYLE = """
:root { color-scheme: light dark; --ink: light-dark(#222, #ddd); --paper: light-dark(#fff, #16181b);
  --faint: light-dark(#666, #9a9a9a); --bar: light-dark(#3a74b0, #6aa5e0); --mark: light-dark(#c33, #f76); }
body { font: 16px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 1080px; margin: 2em auto; padding: 0 1em; }
h2 { margin-top: 2em; border-bottom: 1px solid var(--faint); }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(320px, 1fr)); gap: 1.5em; }
.wide { grid-template-columns: 1fr; }
figure { margin: 0; }
footer { margin-top: 3em; color: var(--faint); font-size: 85%; }
figure img { width: 100%; max-height: 480px; object-fit: contain; object-position: left;
  background: light-dark(#eee, #24272b); border: 1px solid var(--faint); box-sizing: border-box; }
figcaption, .note { color: var(--faint); font-size: 0.9em; }
figcaption b { color: var(--ink); }
table { border-collapse: collapse; }
td, th { text-align: left; padding: 0.15em 1em 0.15em 0; vertical-align: top; }
.wide img { max-height: none; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
.swatch { display: inline-block; width: 1em; height: 1em; border: 1px solid var(--faint); vertical-align: -0.15em; }
svg { width: 100%; max-width: 560px; fill: var(--bar); stroke: none; }
svg text { fill: var(--faint); font-size: 12px; }
svg line { stroke: var(--faint); } svg polyline { fill: none; stroke: var(--bar); stroke-width: 2; }
svg .chosen { fill: var(--mark); }
"""


@dataclass(frozen=True)
class Figure:
    """A picture (a file next to the page) or an SVG, with a title and a caption that says what to look for."""

    title: str
    caption: str
    file: str = ""
    svg: str = ""

    def html(self) -> str:
        shown = f'<img src="{escape(self.file)}" alt="{escape(self.title)}">' if self.file else self.svg
        return f"<figure>{shown}<figcaption><b>{escape(self.title)}.</b> {escape(self.caption)}</figcaption></figure>"


@dataclass(frozen=True)
class Section:
    """A heading, figures side by side (wide: below each other), and HTML below them."""

    title: str
    figures: Sequence[Figure]
    below: str = ""
    wide: bool = False

    def html(self) -> str:
        figures = "".join(figure.html() for figure in self.figures)
        kind = "row wide" if self.wide else "row"
        return f'<h2>{escape(self.title)}</h2><div class="{kind}">{figures}</div>{self.below}'


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Returns a table of two columns, label and value."""
    cells = (f'<tr><td>{escape(a)}</td><td class="number">{escape(b)}</td></tr>' for a, b in rows)
    return f"<table>{''.join(cells)}</table>"


def legend(rows: Sequence[tuple[tuple[int, int, int], str, int, int]], pixels: int) -> str:
    """Returns a table: colour, words, pixels shown, their share, and all pixels that have the reason."""
    body = "".join(
        f'<tr><td><span class="swatch" style="background: rgb{colour}"></span></td><td>{escape(words)}</td>'
        f'<td class="number">{shown}</td><td class="number">{100 * shown / pixels:.1f} %</td>'
        f'<td class="number">{every}</td></tr>'
        for colour, words, shown, every in rows
    )
    head = "<tr><th></th><th>camera pixels</th><th>shown</th><th>share</th><th>all that have it</th></tr>"
    return f"<table>{head}{body}</table>"


def page(title: str, intro: str, sections: Sequence[Section]) -> str:
    """Returns the whole document."""
    body = "".join(section.html() for section in sections)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>'
        f"<body><h1>{escape(title)}</h1>{intro}{body}<footer>{escape(_origin())}</footer></body></html>\n"
    )


def _origin() -> str:
    """Returns the time, version and command that made the page."""
    made = datetime.now().astimezone().isoformat(" ", "minutes")
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return printable(f"Counterlight {metadata.version('counterlight')}, {made}: {command}")
