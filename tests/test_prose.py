"""The texts that python -m tests.prose draws from."""

from pathlib import Path

from tests.prose import sample, texts_of


def test_docstrings_comments_and_help_are_found_with_their_places(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        '"""A module."""\n\nx = 1  # one\n# Two lines\n# together.\n\n\ndef f(add):\n    """Does."""\n'
        '    add(help=f"from {x} on")  # noqa: X1\n'
    )
    found = {(text.line, text.kind, text.words) for text in texts_of(path)}
    assert found == {
        (1, "docstring", "A module."),
        (3, "comment", "one"),
        (4, "comment", "Two lines together."),
        (9, "docstring", "Does."),
        (10, "help", "from … on"),
    }


def test_a_seed_draws_the_same_again_and_others_draw_others() -> None:
    first, again, other = (sample(seed, 50, ("player/show",)) for seed in (3, 3, 4))
    assert first == again != other
    assert len({(text.path, text.line, text.kind) for text in first}) == 50


def test_sentences_of_a_page_are_found_without_code_headings_and_tables(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(
        "# A title\n\nThe first\nsentence stands. **It ends.** The `third` follows\n\n    counterlight build room\n\n"
        "- One item has text.\n- Another item does.\n\n| a cell. | A cell of a table. |\n\n"
        "```sh\nNo code is found.\n```\n"
    )
    assert [(text.line, text.words) for text in texts_of(path)] == [
        (3, "The first sentence stands."),
        (3, "**It ends.** The `third` follows"),
        (8, "- One item has text."),
        (9, "- Another item does."),
    ]
