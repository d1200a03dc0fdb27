"""Random docstrings, comments and help texts with their places, for somebody who judges whether they read well.

    python -m tests.prose --seed 3 --count 100
    python -m tests.prose --seed 3 --count 100 docs README.md     sentences of the pages

A text that has to be read twice points to a pattern: fix the pattern everywhere.
"""

import argparse
import ast
import io
import random
import re
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


def sentences_of(path: Path) -> Iterator[Text]:
    """Yield the sentences of a Markdown page, outside code, headings and tables."""
    page = re.sub(r"```.*?```", lambda code: "\n" * code[0].count("\n"), path.read_text(encoding="utf-8"), flags=re.S)
    for block in re.finditer(r"^ {0,3}(?=[^\s#|!]).*(?:\n(?! *(?:[-*] |\d+\. |[|#\n])).+)*", page, re.MULTILINE):
        line = page.count("\n", 0, block.start()) + 1
        for words in re.split(r"(?<=[.!?])[*_)]? +(?=[*_`(\[]*[A-Z`])", " ".join(block[0].split())):
            if len(words.split()) > 2:
                yield Text(path, line, "sentence", words)


def texts_of(path: Path) -> Iterator[Text]:
    """Yield every text of a Python file or a Markdown page."""
    if path.suffix == ".md":
        yield from sentences_of(path)
        return
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
    found = (path for folder in folders for path in [ROOT / folder, *(ROOT / folder).rglob("*")])
    paths = sorted(path for path in found if path.suffix in {".py", ".md"})
    texts = [text for path in paths for text in texts_of(path)]
    return random.Random(seed).sample(texts, min(count, len(texts)))


def main() -> None:
    parser = argparse.ArgumentParser("python -m tests.prose", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True, help="seed of the random numbers")
    parser.add_argument("--count", type=int, default=100, help="number of texts (default 100)")
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="folders or files (default player tools tests)")
    options = parser.parse_args()
    for number, text in enumerate(sample(options.seed, options.count, tuple(options.folders)), 1):
        print(f"{number}. {text.path.relative_to(ROOT)}:{text.line} ({text.kind})")
        print(textwrap.indent(text.words, "    "), end="\n\n")


if __name__ == "__main__":
    main()
