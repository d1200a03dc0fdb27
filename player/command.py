"""Parts that all commands share: one-line errors, exit codes, progress."""

import argparse
import errno
import io
import os
import re
import select
import shlex
import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TextIO, TypeVar

from counterlight.errors import InputError, nearest, printable

DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SCRIPTS = {"play": "play-corrected", "build": "build-correction-map"}  # verbs that have their own script
LOG_INTERVAL_S = 10.0
BAR = "{desc}: {percentage:3.0f} %|{bar:20}| {n_fmt} of {total_fmt}, {elapsed}, {rate_fmt}, {remaining} left{postfix}"
ROOM_BESIDE_LABEL = 82  # columns that a progress bar needs besides its label
CLEARED = b"\r\x1b[K"  # returns to the beginning of the line and clears it
LAST_WORDS_S = 1.0  # longest wait for the reader of a command's last line
AGAIN_S = 0.01  # pause before a signal that came at a bad time is sent again
JOINED = "\xa0"  # a space at which no line breaks
NEXT = "; next: "
WIDEST = 100  # columns of a help text; longer lines are hard to read

TYPING_ERROR = 0.8  # least closeness; a wrong letter in the shortest option gives 0.8, --report and --remote have 0.75

T = TypeVar("T")
Arguments = argparse._ActionsContainer  # a parser or one of its groups


class _Formatter(argparse.HelpFormatter):
    """Formats help with entries such as `-o, --output FILE` and `--[no-]loop`, in lines of the terminal's width."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns())

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _format_action_invocation(self, action: argparse.Action) -> str:
        if not action.option_strings:
            return super()._format_action_invocation(action)
        if isinstance(action, argparse.BooleanOptionalAction):
            return action.option_strings[0].replace("--", "--[no-]", 1)
        values = "" if action.nargs == 0 else f" {self.values_of(action)}"
        return ", ".join(action.option_strings) + values

    def values_of(self, action: argparse.Action) -> str:
        """Return the placeholders of an action's values, such as `FILE` or `[SECONDS]`."""
        return self._format_args(action, action.dest.upper())

    def _get_default_metavar_for_positional(self, action: argparse.Action) -> str:
        return action.dest.upper()

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        if action.nargs == argparse.ONE_OR_MORE:
            return f"{self._metavar_formatter(action, default_metavar)(1)[0]} ..."
        return super()._format_args(action, default_metavar)

    def _metavar_formatter(self, action: argparse.Action, default_metavar: str) -> Callable[[int], tuple[str, ...]]:
        if action.metavar is None and action.choices is not None:
            default_metavar = "|".join(map(str, action.choices))
        shown = default_metavar if action.metavar is None else action.metavar
        return lambda size: shown if isinstance(shown, tuple) else (shown,) * size


def conclusion(result: str, action: str) -> str:
    """Returns the last line of a command: the result in plain words, and what to do next."""
    return f"{result}{NEXT}{action}"


def command_line(*words: object) -> str:
    """Returns a command as a shell accepts it, such as `counterlight build 'my room'`."""
    return f"counterlight {shlex.join(map(str, words))}"


def add_verbose(arguments: Arguments, figures: str) -> None:
    """Add the option --verbose, which prints figures that are otherwise only in the report and in files."""
    arguments.add_argument("--verbose", action="store_true", help=f"also print {figures}")


class _HelpAll(argparse.Action):
    """Prints the help with all options, and ends the process."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        assert isinstance(parser, Parser)
        sys.stdout.write(parser.format_help(everything=True))
        parser.exit()


class Parser(argparse.ArgumentParser):
    """The argument parser of a verb of `counterlight`. Its errors are one line, like all errors of commands.

    A separate script may stand for the verb. argcomplete completes arguments in shells.

    description : paragraphs; a leading `counterlight VERB:` is left out. Indented lines stay lines.
    examples : command lines.
    common : options that --help shows; empty for all. --help-all shows all options.
    """

    _completes = False

    def __init__(self, verb: str, *, examples: Sequence[str] = (), common: Sequence[str] = (), **settings: Any) -> None:
        called = Path(sys.argv[0]).name
        prog = called if called == SCRIPTS.get(verb) else f"counterlight {verb}".strip()
        super().__init__(prog, formatter_class=_Formatter, add_help=False, **settings)
        self.register("type", Path, _path)
        self.examples, self.common = examples, common
        self._positionals.title = "arguments"
        self._help = self.add_argument_group("help")
        self._help.add_argument("-h", "--help", action="help", help="show this help")
        self._help.add_argument(
            "--help-all", action=_HelpAll, nargs=0, default=argparse.SUPPRESS, help="show all options"
        )

    def format_usage(self) -> str:
        """Return one line with the required options and the arguments."""
        if self.usage is not None:
            return super().format_usage()
        formatter = _Formatter(self.prog)
        required = [action for action in self._get_optional_actions() if action.required]
        parts = [f"{action.option_strings[0]} {formatter.values_of(action)}" for action in required]
        parts += ["[OPTION ...]", *map(formatter.values_of, self._get_positional_actions())]
        words = " ".join([self.prog, *(part.replace(" ", JOINED) for part in parts)])
        return _hanging(f"usage: {words}").replace(JOINED, " ") + "\n"

    def format_help(self, *, everything: bool = False) -> str:
        """Return the help with the common options, or with all options, in groups."""
        formatter = self._get_formatter()
        groups = [group for group in self._action_groups if group is not self._help]
        for group in (*groups, self._help):
            formatter.start_section(group.title)
            formatter.add_arguments(each for each in group._group_actions if self._is_listed(each, everything))
            formatter.end_section()
        examples = "\n".join(["examples:", *(f"  {line}" for line in self.examples)]) if self.examples else ""
        purpose = re.sub(r"^counterlight [\w-]+: ", "", self.description or "")
        epilog = self.epilog if everything or not self.common else ""
        texts = purpose[:1].upper() + purpose[1:], examples
        parts = [self.format_usage(), *map(_wrapped, texts), formatter.format_help(), _wrapped(epilog or "")]
        return "\n\n".join(part.strip("\n") for part in parts if part) + "\n"

    def _is_listed(self, action: argparse.Action, everything: bool) -> bool:
        if everything or not action.option_strings or action.required or action.dest == "help":
            return True
        if action.dest == "help_all":
            return bool(self.common)
        return not self.common or any(name in self.common for name in action.option_strings)

    def error(self, message: str) -> NoReturn:
        unknown = next(iter(message.removeprefix("unrecognized arguments: ").split()), "")  # an argument may be blank
        name = unknown.partition("=")[0]
        hint = nearest(name, self._option_string_actions, TYPING_ERROR) if unknown.startswith("--") else ""
        raise InputError(f"{self.prog}: {message}{hint}; see {self.prog} --help")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments. Positional arguments, even optional ones, may follow options."""
        return self.parse_intermixed_args(args, namespace)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        self._complete()
        return super().parse_known_args(args, namespace)

    def parse_known_intermixed_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        self._complete()
        return super().parse_known_intermixed_args(args, namespace)

    def _complete(self) -> None:
        if "_ARGCOMPLETE" in os.environ and not Parser._completes:
            import argcomplete

            Parser._completes = True  # skips the check of arguments below, because argcomplete calls the parser itself
            argcomplete.autocomplete(self)  # ends the process

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = list(map(str, action.choices))
            complaint = f"invalid choice: {value!r} (choose from {', '.join(known)}){nearest(str(value), known)}"
            raise argparse.ArgumentError(action, complaint)


def _path(text: str) -> Path:
    if not text:  # a shell's unset variable; Path("") would mean the current folder
        raise argparse.ArgumentTypeError("is empty; expected a path")
    return Path(text)


def _columns() -> int:
    return min(shutil.get_terminal_size().columns - 2, WIDEST)


def _wrapped(text: str) -> str:
    """Break paragraphs into lines of the terminal's width. A list with indented lines keeps its lines."""
    paragraphs = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.split("\n") if "\n  " in paragraph else [paragraph]
        paragraphs.append("\n".join(map(_hanging, lines)))
    return "\n\n".join(paragraphs)


def _hanging(line: str) -> str:
    """Break a line. The further lines of an indented line, and of a usage, begin below its second word."""
    head = re.match(r"(?: +\S+ +|usage: )?", line)
    indent = " " * (head.end() if head else 0)
    return textwrap.fill(line, _columns(), subsequent_indent=indent, break_on_hyphens=False)


def run(body: Callable[[Sequence[str] | None], int | None], argv: Sequence[str] | None = None) -> int:
    """Run a command's body. Returns the exit code: 0 done, 2 bad input, 130 interrupted. Other exceptions pass."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names may be invalid text; stderr escapes them as well
    signal.signal(signal.SIGTERM, _interrupt)  # clean up on `kill` as on Ctrl-C
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup ignores SIGHUP
        signal.signal(signal.SIGHUP, _interrupt)  # clean up when the terminal closes
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        code = body(argv) or DONE
        sys.stdout.flush()
        return code
    except InputError as error:
        tell(f"error: {error}", patience_s=LAST_WORDS_S)
        return BAD_INPUT
    except BrokenPipeError:
        _say_no_more()  # the reader of the output has ended (`… | head`)
        return DONE
    except OSError as error:
        if error.errno == errno.ENOSPC and error.filename is None:
            _say_no_more()
            tell(f"error: what is printed, or kept meanwhile: {error.strerror}; make room", patience_s=LAST_WORDS_S)
            return BAD_INPUT
        if error.filename is None:
            if error.errno != errno.ENOENT or _has_current_folder():
                raise
            tell("error: the current folder no longer exists; change to another one (cd)", patience_s=LAST_WORDS_S)
            return BAD_INPUT
        tell(f"error: {error.filename}: {error.strerror}; check the path and its rights", patience_s=LAST_WORDS_S)
        return BAD_INPUT
    except KeyboardInterrupt as signalled:
        notes = dict.fromkeys(getattr(signalled, "__notes__", []))  # what the interrupted parts say (Python 3.11)
        tell(": ".join(["interrupted", *notes]), patience_s=LAST_WORDS_S)
        return INTERRUPTED


def _has_current_folder() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def verb(body: Callable[[Sequence[str] | None], int | None]) -> partial[int]:
    """Make the `main` of a command from its body, with `run`."""
    return partial(run, body)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt. During a callback of GLFW, which would lose it, send the signal again a little later."""
    while frame is not None:
        if frame.f_code.co_name == "callback_wrapper" and frame.f_globals.get("__name__") == "glfw":
            threading.Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _say_no_more() -> None:
    """Discard output that cannot be written, because flushing it at exit would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def tell(line: str, stream: TextIO | None = None, *, patience_s: float = 0.0) -> None:
    """Print a line (to stderr). If the reader does not read within `patience_s`, only the line is lost."""
    stream = stream or sys.stderr
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError):  # stderr is no system file in a test
        print(line, file=stream)
        return
    start = CLEARED if stream.isatty() else b""
    _write(descriptor, start + printable(line).encode()[: select.PIPE_BUF - len(start) - 1] + b"\n", patience_s)


def status(line: str) -> None:
    """Show a line on the terminal (stderr) in place of the last line. `tell` overwrites it. Needs a terminal."""
    if sys.stderr.isatty():
        columns = shutil.get_terminal_size().columns
        _write(sys.stderr.fileno(), CLEARED + printable(line)[: columns - 1].encode(), 0.0)


def _write(descriptor: int, data: bytes, patience_s: float) -> None:
    with suppress(OSError, ValueError):
        if select.select([], [descriptor], [], patience_s)[1]:  # a writable pipe accepts at least PIPE_BUF bytes
            os.write(descriptor, data)


def parse_size(text: str) -> tuple[int, int]:
    """Parse `640x480` -> (480, 640), that is (height, width)."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"a size is WIDTHxHEIGHT, such as 640x480, found {text!r}")
    return int(height), int(width)


def parse_decibels(text: str) -> float:
    """Parse `0.1dB` or `0.1` -> 0.1."""
    expectation = f"decibels are a number of at least 0, such as 0.1dB, found {text!r}"
    return at_least_0(text.lower().removesuffix("db"), expectation)


def at_least_0(text: str, expectation: str) -> float:
    """Parse a number ≥ 0. Raises ArgumentTypeError with the message `expectation` for other text."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < float("inf"):
        raise argparse.ArgumentTypeError(expectation)
    return number


def parse_seconds(text: str) -> float:
    return at_least_0(text, f"expected a number of seconds, 0 or more, found {text!r}")


def progress_bar(label: str, total: int | None) -> Any:
    """Return a tqdm bar on stderr whose length does not depend on its label."""
    from tqdm import tqdm  # imported late, because counterlight doctor uses this module to report a missing tqdm

    # 80x24 if the terminal does not state its size; tqdm alone would then draw no bar
    columns, lines = shutil.get_terminal_size()
    room = max(columns - ROOM_BESIDE_LABEL, 10)
    short = label if len(label) <= room else f"{label[: room - 1]}…"
    shown = None if total is None else BAR
    return tqdm(desc=short, total=total, leave=False, ncols=columns, nrows=lines, bar_format=shown)


def _progress(count: int, total: int | None, seconds: float) -> str:
    """Return `30 of 100, 11 s, 2.7 per second, 26 s left`."""
    progress = f"{count}{'' if total is None else f' of {total}'}, {seconds:.0f} s"
    if not count or total is None:
        return progress
    rate = count / seconds
    return f"{progress}, {rate:.3g} per second, {max(total - count, 0) / rate:.0f} s left"


def track(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """Yield `items` with a progress bar on a terminal, otherwise with a log line every LOG_INTERVAL_S (stderr)."""
    if sys.stderr.isatty():
        with progress_bar(label, len(items) if total is None and isinstance(items, Sized) else total) as bar:
            for item in items:
                yield item
                bar.update()
        return
    start = last = time.monotonic()
    for count, item in enumerate(items):
        now = time.monotonic()
        if now - last >= LOG_INTERVAL_S:
            print(f"{label}: {_progress(count, total, now - start)}", file=sys.stderr)
            last = now
        yield item
