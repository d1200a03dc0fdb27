"""Tables of a study's page."""

from collections.abc import Sequence
from html import escape


def number(value: float | int | str | None) -> str:
    """Returns three digits, or whole numbers from 1000; a dash for None."""
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def html_table(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Returns a table; cells that begin with a digit are aligned right."""
    head = "".join(f"<th>{escape(words)}</th>" for words in header)
    lines = "".join(f"<tr>{''.join(map(_cell, line))}</tr>" for line in body)
    return f"<table><tr>{head}</tr>{lines}</table>"


def _cell(words: str) -> str:
    kind = ' class="number"' if words.lstrip("-")[:1].isdigit() or words in ("", "–") else ""
    return f"<td{kind}>{escape(words)}</td>"
