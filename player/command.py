"""What every command shares: one-line errors, exit codes, progress."""

import argparse
import errno
import io
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import NoReturn, TextIO, TypeVar

from counterlight.errors import InputError, printable

DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
LOG_INTERVAL_S = 10.0
LAST_WORDS_S = 1.0  # how long the reader of a command's last line is waited for

T = TypeVar("T")


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, like every other error."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{self.prog}: {message}; see {self.prog} --help")


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
    with suppress(OSError, ValueError):
        if select.select([], [descriptor], [], patience_s)[1]:  # a pipe then takes PIPE_BUF bytes
            os.write(descriptor, printable(line).encode()[: select.PIPE_BUF - 1] + b"\n")


def parse_size(text: str) -> tuple[int, int]:
    """`640x480` -> (480, 640), that is (height, width)."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"a size is WIDTHxHEIGHT, such as 640x480, found {text!r}")
    return int(height), int(width)


def track(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """Yield `items` with a progress bar on a terminal, otherwise with a log line now and then (stderr)."""
    if sys.stderr.isatty():
        from tqdm import tqdm  # counterlight doctor reports a tqdm that is missing by means of this module

        yield from tqdm(items, desc=label, total=total, leave=False)
        return
    start = last = time.monotonic()
    for count, item in enumerate(items):
        now = time.monotonic()
        if now - last >= LOG_INTERVAL_S:
            of = f" of {total}" if total is not None else ""
            print(f"{label}: {count}{of}, {now - start:.0f} s", file=sys.stderr)
            last = now
        yield item
