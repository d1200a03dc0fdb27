"""Adds the generated pages to the site (mkdocs.yml), and formats the parameters of docstrings as lists."""

import re

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from tests.reference import pages

PARAMETER = re.compile(r"^(\w+(?:, \w+)*) : ", re.MULTILINE)

CODE = re.compile(r"`([^`\n]*\\\|[^`\n]*)`")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Remove the backslash of `\\|` in code, which the site would show, and link to notebooks as pages."""
    markdown = markdown.replace(".ipynb)", ".md)")
    return CODE.sub(lambda code: f"<code>{_entities(code[1].replace(chr(92), ''))}</code>", markdown)


def _entities(code: str) -> str:
    return "".join(each if each.isalnum() or each in " -" else f"&#{ord(each)};" for each in code)


class ListedParameters(griffe.Extension):
    """Turns lines `name : text` of a docstring into a list, because Markdown would join the lines."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        if obj.docstring:
            obj.docstring.value = PARAMETER.sub(r"\n- **\1**: ", obj.docstring.value)
