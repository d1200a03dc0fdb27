"""Random docstrings, comments and help texts with their places, for somebody who judges whether they read well.

    python -m tests.prose --seed 3 --count 100

A text that has to be read twice points to a pattern: fix the pattern everywhere (docs/ is not sampled).
"""

import argparse
import ast
import io
import random
import textwrap
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = "player", "tools", "tests"
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Text(NamedTuple):
    """Docstring, comment or help text, and its position."""

    path: Path
    line: int
    kind: str
    words: str


def texts_of(path: Path) -> Iterator[Text]:
    """Yield every text of a Python file."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, DOCUMENTED) and (docstring := ast.get_docstring(node)):
            yield Text(path, node.body[0].lineno, "docstring", docstring)
        elif isinstance(node, ast.keyword) and node.arg == "help" and (words := _literal(node.value)):
            yield Text(path, node.value.lineno, "help", words)
    yield from _comments(path, source)


def _comments(path: Path, source: str) -> Iterator[Text]:
    """Yield comments; comments that stand alone on consecutive lines are joined."""
    block: list[tokenize.TokenInfo] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or token.string.startswith(("# noqa", "# type:", "# fmt:")):
            continue
        follows_code = token.line[: token.start[1]].strip() != ""
        if block and (follows_code or token.start[0] != block[-1].start[0] + 1 or token.start[1] != block[-1].start[1]):
            yield _joined(path, block)
            block = []
        block.append(token)
    if block:
        yield _joined(path, block)


def _joined(path: Path, block: list[tokenize.TokenInfo]) -> Text:
    return Text(path, block[0].start[0], "comment", " ".join(token.string.lstrip("#! ") for token in block))


def _literal(node: ast.expr) -> str:
    """Text of a string literal, with … for formatted values."""
    if isinstance(node, ast.JoinedStr):
        return "".join(_literal(part) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def sample(seed: int, count: int, folders: tuple[str, ...] = FOLDERS) -> list[Text]:
    """Draw random texts with equal probability."""
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    texts = [text for path in paths for text in texts_of(path)]
    return random.Random(seed).sample(texts, min(count, len(texts)))


def main() -> None:
    parser = argparse.ArgumentParser("python -m tests.prose", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True, help="seed of the random numbers")
    parser.add_argument("--count", type=int, default=100, help="number of texts (default 100)")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="folders to draw from (default player tools tests)")
    options = parser.parse_args()
    for number, text in enumerate(sample(options.seed, options.count, tuple(options.folders)), 1):
        print(f"{number}. {text.path.relative_to(ROOT)}:{text.line} ({text.kind})")
        print(textwrap.indent(text.words, "    "), end="\n\n")


if __name__ == "__main__":
    main()
