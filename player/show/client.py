"""A client of a show: answers its requests and reports the properties that it observes, with bounded buffers.

control.py documents the lines.
"""

import contextlib
import json
import socket
import time
from collections.abc import Callable
from typing import Any

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.show.registry import Commands
from counterlight.unattended.json_lines import encode

VERSION = 1 << 16  # version of this protocol, numbered as in mpv: major << 16 | minor
MAX_LINE = 64 << 10  # most bytes of a line
MAX_UNSENT = 256 << 10  # in bytes; a client with more unsent bytes gets no changes, and its requests wait
MAX_OBSERVED = 128  # most observed properties per client
_CHUNK = 16 << 10


class Values(dict[str, object]):
    """Property values, each read at most once per poll. The value is None if the property has none now."""

    def __init__(self, commands: Commands) -> None:
        super().__init__()
        self._commands = commands

    def __missing__(self, name: str) -> object:
        value: object = None
        if name in self._commands.properties():
            with contextlib.suppress(Exception):
                value = self._commands.get(name)
        self[name] = value
        return value


class _RefusedError(Exception):
    """A refused request: mpv's error word, and a line with the details."""

    def __init__(self, word: str, message: str) -> None:
        super().__init__(message)
        self.word = word


_OVERLONG = b"a line that was thrown away"
_INVALID, _UNKNOWN, _READ_ONLY = "invalid parameter", "property not found", "error accessing property"
_FAILED = "error running command"
_EXPECTED = '{"command": [NAME, ...], "request_id": N}'


class Client:
    """One connection: received bytes, bytes still to send, and observed properties."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self._socket, self._name = connection, name
        self._arrived, self._unsent = bytearray(), bytearray()
        self._overlong = self._ended = False
        self._observed: list[_Observation] = []
        self._deaf: set[str] = set()
        self.gone = False
        self._requests: dict[str, Callable[..., object]] = {
            "client_name": lambda commands: self._name,
            "get_version": lambda commands: VERSION,
            "get_time_us": lambda commands: time.monotonic_ns() // 1000,
            "get_property": _get,
            "get_property_string": lambda commands, name: as_text(_get(commands, name)),
            "set_property": _set,
            "set_property_string": lambda commands, name, text: _set(commands, name, _expect(text, str)),
            "observe_property": self._observe,
            "observe_property_string": lambda *words: self._observe(*words, text=True),
            "unobserve_property": self._unobserve,
            "enable_event": lambda commands, event: self._deaf.discard(_expect(event, str)),
            "disable_event": self._disable,
        }

    def receive(self, commands: Commands, deadline: float) -> None:
        """Run the received lines until the deadline, at least one line. The remaining lines wait for the next poll."""
        while len(self._unsent) < MAX_UNSENT and not self.gone:
            line = self._next_line()
            if line is None:
                self.gone = self._ended
                return
            if line.strip():
                self._unsent += encode(self._answer(commands, line))
                self.flush()
            if time.monotonic() > deadline:
                return

    def tell(self, event: str, **facts: object) -> None:
        """Send an event, unless the client has disabled it or too many bytes are unsent."""
        if len(self._unsent) < MAX_UNSENT and event not in self._deaf:
            self._unsent += encode({"event": event, **facts})

    def tell_changes(self, values: Values) -> None:
        """Send the observed properties whose value differs from the value sent last. Values in between are skipped."""
        for observation in self._observed:
            if len(self._unsent) >= MAX_UNSENT:
                return
            if "property-change" not in self._deaf:
                self._unsent += observation.news(values[observation.name])

    def flush(self) -> None:
        """Send as much as the client accepts now."""
        while self._unsent and not self.gone:
            try:
                del self._unsent[: self._socket.send(self._unsent[:_CHUNK])]
            except BlockingIOError:
                return
            except OSError:
                self.gone = True

    def close(self) -> None:
        self._socket.close()

    def _next_line(self) -> bytes | None:
        """Return the next whole line, None if none has arrived. Discards a line longer than MAX_LINE."""
        while True:
            end = self._arrived.find(b"\n")
            if end >= 0:
                line = bytes(self._arrived[:end])
                del self._arrived[: end + 1]
                if not self._overlong:
                    return line
                self._overlong = False
                return _OVERLONG
            if self._overlong or len(self._arrived) > MAX_LINE:
                self._overlong = True
                self._arrived.clear()
            if not self._read():
                return None

    def _read(self) -> bool:
        try:
            piece = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return False
        except OSError:
            piece = b""
        self._ended = not piece
        self._arrived += piece
        return bool(piece)

    def _answer(self, commands: Commands, line: bytes) -> dict[str, object]:
        request: dict[str, Any] = {}
        try:
            request = _parse(line)
            name, *arguments = _words(request)
            return {"request_id": _number(request), "error": "success", "data": self._run(commands, name, arguments)}
        except _RefusedError as refusal:
            return {"request_id": _number(request), "error": refusal.word, "message": str(refusal)}

    def _run(self, commands: Commands, name: str, arguments: list[object]) -> object:
        request = self._requests.get(name)
        if request is None and name not in commands.names():
            raise _RefusedError(_INVALID, f"{name[:80]}: no such command; get_property command-list names them")
        try:
            return commands.run(name, *arguments) if request is None else request(commands, *arguments)
        except (ValueError, InputError) as error:
            raise _RefusedError(_FAILED, str(error)) from None
        except TypeError:
            raise _RefusedError(_INVALID, f"{name}: not with these {len(arguments)} arguments") from None
        except _RefusedError:
            raise
        except Exception as error:  # a client's line must not end the show
            tell(f"control: {name} failed: {error!r}")
            raise _RefusedError(_FAILED, f"{name} failed: {error!r}") from None

    def _observe(self, commands: Commands, number: object, name: object, *, text: bool = False) -> None:
        observation = _Observation(_expect(number, int), _known(commands, name), text)
        if len(self._observed) >= MAX_OBSERVED:
            raise _RefusedError(_INVALID, f"more than {MAX_OBSERVED} observed properties; unobserve some")
        self._observed.append(observation)

    def _unobserve(self, _: Commands, number: object) -> int:
        """Stop observing the properties with this number, and return how many there were."""
        kept = [observation for observation in self._observed if observation.number != _expect(number, int)]
        count, self._observed = len(self._observed) - len(kept), kept
        return count

    def _disable(self, _: Commands, event: object) -> None:
        known = ("property-change", "start-file", "end-file", "shutdown")
        if event not in known:
            raise _RefusedError(_INVALID, f"expected one of {', '.join(known)}")
        self._deaf.add(_expect(event, str))


class _Observation:
    """A property that a client observes, with the value and the line sent last."""

    def __init__(self, number: int, name: str, text: bool) -> None:
        self.number, self.name, self._text = number, name, text
        self._value: object = None
        self._sent = b""

    def news(self, value: object) -> bytes:
        """Return the line that reports a value, or b"" if the client already has this value."""
        if self._sent and value == self._value:  # avoids encoding a list of thousands only to compare it
            return b""
        data = as_text(value) if self._text else value
        line = encode({"event": "property-change", "id": self.number, "name": self.name, "data": data})
        self._value, before, self._sent = value, self._sent, line
        return b"" if line == before else line


def as_text(value: object) -> str:
    """Return a value in mpv's text form: yes and no, six decimals, and JSON for lists and objects."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6f}"
    return value if isinstance(value, str) else encode(value).decode().strip()


def _parse(line: bytes) -> dict[str, Any]:
    if line is _OVERLONG:
        raise _RefusedError(_INVALID, f"a line of more than {MAX_LINE} bytes")
    with contextlib.suppress(ValueError, RecursionError):  # not UTF-8, not JSON, too many digits; too many brackets
        request = json.loads(line)
        if isinstance(request, dict):
            return request
    raise _RefusedError(_INVALID, f"no JSON object; expected {_EXPECTED}")


def _words(request: dict[str, Any]) -> list[Any]:
    """Return the command of a request: a list that begins with a name."""
    words = request.get("command")
    if isinstance(words, list) and words and isinstance(words[0], str):
        return words
    raise _RefusedError(_INVALID, f"expected {_EXPECTED}")


def _number(request: dict[str, Any]) -> int:
    number = request.get("request_id", 0)
    return number if isinstance(number, int) else 0


def _get(commands: Commands, name: object) -> object:
    if name == "command-list":
        return [
            {"name": command, "help": text, "usage": commands.usage(command)}
            for command, text in commands.names().items()
        ]
    if name == "property-list":
        return list(commands.properties())
    if name == "property-info":
        return [commands.info(each) for each in commands.properties()]
    return commands.get(_known(commands, name))


def _set(commands: Commands, name: object, value: object) -> None:
    known = _known(commands, name)
    if not commands.writable(known):
        raise _RefusedError(_READ_ONLY, f"{known}: can be read only")
    commands.set(known, value)


def _known(commands: Commands, name: object) -> str:
    if not isinstance(name, str) or name not in commands.properties():
        raise _RefusedError(_UNKNOWN, f"{str(name)[:80]}: no such property; get_property property-list names them")
    return name


def _expect(value: object, kind: type) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise _RefusedError(
            _INVALID, f"expected {'a whole number' if kind is int else 'text'}, found {str(value)[:80]}"
        )
    return value
