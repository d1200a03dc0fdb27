"""The registry of commands and properties: accepted values, refusals in one line, and use by keys."""

import re
from types import SimpleNamespace

import pytest

from counterlight.errors import InputError
from counterlight.pipeline.value_types import Choice, Flag, Number
from counterlight.show.keys import KEYS, MEANINGS, PLACING, Keys, check_bindings
from counterlight.show.registry import Command, CommandError, Commands, Property


@pytest.fixture
def state() -> SimpleNamespace:
    return SimpleNamespace(pause=False, gain=0, share=0.5, view="plain", refine=0, calls=[])


@pytest.fixture
def commands(state: SimpleNamespace) -> Commands:
    def of(name: str, kind: object, unit: str = "") -> Property:
        return Property(name, lambda: getattr(state, name), lambda value: setattr(state, name, value), kind, unit)  # type: ignore[arg-type]

    return Commands(
        {"note": Command("keep words", lambda *words: state.calls.append(words), "WORD [WORD]")},
        {
            "pause": of("pause", Flag()),
            "gain": of("gain", Number(-3, 3, whole=True)),
            "share": of("share", Number(0, 1), "of it"),
            "view": of("view", Choice(("plain", "split"))),
            "refine": of("refine", Number(0, 8, whole=True, words=("auto",)), "steps"),
            "frames": Property("how many", lambda: 7),
        },
    )


def test_values_come_as_json_or_as_words(commands: Commands, state: SimpleNamespace) -> None:
    for value, expected in (("yes", True), (False, False), ("on", True)):
        commands.set("pause", value)
        assert state.pause is expected
    for given, gain in ((2, 2), ("-3", -3), (1.0, 1)):
        commands.run("set", "gain", given)
        assert state.gain == gain
        assert isinstance(state.gain, int)
    commands.set("refine", "auto")
    assert commands.get("refine") == "auto"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("set", "gain", 4), "gain: expected a whole number from -3 to 3, found 4"),
        (("set", "gain", 0.5), "gain: expected a whole number"),
        (("set", "gain", True), "found True"),
        (("set", "gain", "nan"), "found 'nan'"),
        (("set", "gain", "1" * 400), "expected a whole number"),
        (("set", "gain", [1]), "found [1]"),
        (("set", "pause", "maybe"), "pause: expected yes or no, found 'maybe'"),
        (("set", "view", "side"), "view: expected plain, split, found 'side'"),
        (("set", "refine", "all"), "expected auto or a whole number"),
        (("set", "frames", 1), "frames is read-only"),
        (("set", "gian", 1), "no property 'gian'; did you mean 'gain'?"),
        (("set", {}, 1), "no property {}"),
        (("nite", "a"), "no command 'nite'; did you mean 'note'?"),
        (("note",), "note: expected WORD [WORD], found none"),
        (("note", 1, 2, 3), "note: expected WORD [WORD], found 1 2 3"),
        (("add", "view"), "view is no number now, but 'plain'"),
        (("cycle", "view", "sideways"), "cycle: expected up or down, found 'sideways'"),
        (("cycle", "frames"), "has no next value"),
    ],
)
def test_what_is_refused_is_said_in_one_line(
    commands: Commands, state: SimpleNamespace, words: tuple[object, ...], complaint: str
) -> None:
    before = dict(vars(state))
    with pytest.raises(CommandError) as caught:
        commands.run(*words)  # type: ignore[arg-type]
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert vars(state) == before


def test_cycle_add_and_multiply(commands: Commands, state: SimpleNamespace) -> None:
    for expected in ("split", "plain"):
        commands.run("cycle", "view")
        assert state.view == expected
    commands.run("cycle", "view", "down")
    assert state.view == "split"
    for expected in (2, 3, 3):  # stops at the end
        commands.run("add", "gain", "2" if expected == 2 else 1)
        assert state.gain == expected
    commands.run("add", "share", "-0.75")
    assert state.share == 0.0
    for factor, expected in ((2, 1), (2, 2), (2, 4), (2, 8), (2, 8), (0.5, 4), (0.5, 2), (0.5, 1), (0.5, 0), (0.5, 0)):
        commands.run("multiply", "refine", factor)
        assert state.refine == expected


def test_keys_run_commands_and_say_what_they_changed(commands: Commands, state: SimpleNamespace) -> None:
    keys = Keys(
        commands, {"p": "", "a": "cycle pause", "b": "add share 0.25", "c": 'note "two words" 3', "d": "add gain 9"}
    )
    assert keys.press("a", placing=False) == "Pause: on"
    assert keys.press("b", placing=False) == "Share: 0.75 of it"
    assert keys.press("c", placing=False) == ""
    assert state.calls == [("two words", "3")]
    assert keys.press("d", placing=False) == "Gain: 3"
    assert keys.press("p", placing=False) == ""  # no command is bound to p
    assert keys.press("not a key", placing=False) == ""
    assert state.pause is True
    assert "no command 'quit'" in keys.press("q", placing=False)  # this registry lacks the command


def test_every_key_is_on_the_help_page(commands: Commands) -> None:
    keys = Keys(commands)
    for placing, table in ((False, KEYS), (True, PLACING)):
        cells = [cell.split("\t") for cell in keys.help_cells(placing=placing)]
        assert {key for names, _ in cells for key in names.split()} == table.keys()
        assert {meaning for _, meaning in cells} == {MEANINGS[command] for command in table.values()}


def test_bindings_that_are_no_commands_are_refused() -> None:
    with pytest.raises(CommandError, match=r"key 'x': expected a command as text, found 3"):
        check_bindings({"x": 3})
    with pytest.raises(CommandError, match="key 'y': No closing quotation"):
        check_bindings({"y": 'show-text "a'})
    for key in ("spcae", "ctrl+", "shift+a", "ctrl+shift+a", "f13", ""):
        with pytest.raises(CommandError, match=f"no key {re.escape(repr(key))}"):
            check_bindings({key: "quit"})
    assert check_bindings({"ctrl++": "", "shift+left": "a", "+": "b", "wheel-up": "c"})


def test_bindings_that_can_never_do_anything_are_refused_at_the_start(commands: Commands) -> None:
    for line, why in {
        "nte x": "no command 'nte'; did you mean 'note'",
        "note": "note: expected",
        "set gian 3": "no property 'gian'; did you mean 'gain'",
        "set gain much": "gain: expected",
    }.items():
        with pytest.raises(InputError, match=f"settings, key 'n': {why}"):
            Keys(commands, {"n": line})
    Keys(commands, {"n": "  ", "m": "set gain 3"})
