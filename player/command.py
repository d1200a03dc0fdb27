"""What every command shares: one-line errors, exit codes, progress."""

import argparse
import errno
import io
import os
import select
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TextIO, TypeVar

from counterlight.errors import InputError, nearest, printable

DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
SCRIPTS = {"play": "play-corrected", "build": "build-correction-map"}  # verbs that have one
LOG_INTERVAL_S = 10.0
BAR = "{desc}: {percentage:3.0f} %|{bar:20}| {n_fmt} of {total_fmt}, {elapsed}, {rate_fmt}, {remaining} left{postfix}"
ROOM_BESIDE_LABEL = 82  # columns
CLEARED = b"\r\x1b[K"  # to the beginning of the line, of which nothing is left
LAST_WORDS_S = 1.0  # how long the reader of a command's last line is waited for

TYPING_ERROR = 0.8  # of the shortest options, one wrong letter; --report and --remote have 0.75

T = TypeVar("T")


class Parser(argparse.ArgumentParser):
    """The arguments of a verb of `counterlight`; complaints are one line, like every other error.

    A script of its own may stand for the verb. Shells complete by it, where argcomplete asks.
    """

    _completes = False

    def __init__(self, verb: str, **settings: Any) -> None:
        called = Path(sys.argv[0]).name
        super().__init__(called if called == SCRIPTS.get(verb) else f"counterlight {verb}".strip(), **settings)

    def error(self, message: str) -> NoReturn:
        unknown = message.removeprefix("unrecognized arguments: ").split()[0]
        name = unknown.partition("=")[0]
        hint = nearest(name, self._option_string_actions, TYPING_ERROR) if unknown.startswith("--") else ""
        raise InputError(f"{self.prog}: {message}{hint}; see {self.prog} --help")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Positional arguments may come after options, those that may be left out, too."""
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

            Parser._completes = True  # it parses, too
            argcomplete.autocomplete(self)  # ends the process

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = list(map(str, action.choices))
            complaint = f"invalid choice: {value!r} (choose from {', '.join(known)}){nearest(str(value), known)}"
            raise argparse.ArgumentError(action, complaint)


def run(body: Callable[[Sequence[str] | None], int | None], argv: Sequence[str] | None = None) -> int:
    """Run a command's body and turn its outcome into an exit code (0 done, 1 fault, 2 bad input, 130 interrupted)."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: names of files need not be text
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # clean up on `kill` as on Ctrl-C
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # which nohup asks for
        signal.signal(signal.SIGHUP, signal.default_int_handler)  # and when the terminal goes
    try:
        code = body(argv) or DONE
        sys.stdout.flush()
        return code
    except InputError as error:
        tell(f"error: {error}", patience_s=LAST_WORDS_S)
        return BAD_INPUT
    except BrokenPipeError:
        _say_no_more()  # the reader of our output has gone (`… | head`): nobody is left to tell
        return DONE
    except OSError as error:
        if error.errno == errno.ENOSPC and error.filename is None:
            _say_no_more()
            tell(f"error: what is printed, or kept meanwhile: {error.strerror}; make room", patience_s=LAST_WORDS_S)
            return BAD_INPUT
        if error.filename is None:
            raise
        tell(f"error: {error.filename}: {error.strerror}; check the path and its rights", patience_s=LAST_WORDS_S)
        return BAD_INPUT
    except KeyboardInterrupt:
        tell("interrupted: nothing half-written remains", patience_s=LAST_WORDS_S)
        return INTERRUPTED


def _say_no_more() -> None:
    """What was printed and cannot be written is given up: flushing at exit would fail again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def tell(line: str, stream: TextIO | None = None, *, patience_s: float = 0.0) -> None:
    """Print a line (to stderr) if it can be done at once: whoever does not read, or has gone, costs the line alone."""
    stream = stream or sys.stderr
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError):  # not a file of the system's, in a test
        print(line, file=stream)
        return
    start = CLEARED if stream.isatty() else b""
    _write(descriptor, start + printable(line).encode()[: select.PIPE_BUF - len(start) - 1] + b"\n", patience_s)


def status(line: str) -> None:
    """Show a line on the terminal (stderr) in place of the one before; `tell` writes over it. Nothing elsewhere."""
    if sys.stderr.isatty():
        columns = shutil.get_terminal_size().columns
        _write(sys.stderr.fileno(), CLEARED + printable(line)[: columns - 1].encode(), 0.0)


def _write(descriptor: int, data: bytes, patience_s: float) -> None:
    with suppress(OSError, ValueError):
        if select.select([], [descriptor], [], patience_s)[1]:  # a pipe then takes PIPE_BUF bytes
            os.write(descriptor, data)


def parse_size(text: str) -> tuple[int, int]:
    """`640x480` -> (480, 640), that is (height, width)."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"a size is WIDTHxHEIGHT, such as 640x480, found {text!r}")
    return int(height), int(width)


def parse_decibels(text: str) -> float:
    """`0.1dB` or `0.1` -> 0.1."""
    told = f"decibels are a number of at least 0, such as 0.1dB, found {text!r}"
    return at_least_0(text.lower().removesuffix("db"), told)


def at_least_0(text: str, told: str) -> float:
    """A number from 0 up; what is none is refused in the words `told`."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < float("inf"):
        raise argparse.ArgumentTypeError(told)
    return number


def progress_bar(label: str, total: int | None) -> Any:
    """A tqdm bar on stderr that keeps its length however long its label is."""
    from tqdm import tqdm  # counterlight doctor reports a tqdm that is missing by means of this module

    columns, lines = shutil.get_terminal_size()  # 80x24 where a terminal does not say; tqdm would then draw nothing
    room = max(columns - ROOM_BESIDE_LABEL, 10)
    short = label if len(label) <= room else f"{label[: room - 1]}…"
    shown = None if total is None else BAR
    return tqdm(desc=short, total=total, leave=False, ncols=columns, nrows=lines, bar_format=shown)


def _progress(count: int, total: int | None, seconds: float) -> str:
    """`30 of 100, 11 s, 2.7 per second, 26 s left`."""
    told = f"{count}{'' if total is None else f' of {total}'}, {seconds:.0f} s"
    if not count or total is None:
        return told
    rate = count / seconds
    return f"{told}, {rate:.3g} per second, {max(total - count, 0) / rate:.0f} s left"


def track(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """Yield `items` with a progress bar on a terminal, otherwise with a log line now and then (stderr)."""
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
