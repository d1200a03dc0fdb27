"""JSON lines (one JSON value per line) of the control socket and the heartbeat, and a command to a player."""

import json
import math
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path

from counterlight.errors import InputError, one_line, shown


def encode(value: object) -> bytes:
    """Encode a value as a line of JSON in ASCII. NaN and infinity become null."""
    return json.dumps(finite(value), allow_nan=False).encode("ascii") + b"\n"


def finite(value: object) -> object:
    """Replace NaN and infinity by None, and convert tuples and mappings to JSON's types."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(item) for item in value]
    return value


PATIENCE_S = 30.0
LONGEST = 1 << 16
FIX = "is the player running with --control and this name?"


def check_control(control: Path) -> None:
    """Raise InputError if `control` is not a socket. Call this before long work."""
    if not control.is_socket():
        raise InputError(f"{control}: no socket; {FIX}")


def ask(control: Path, *command: str) -> None:
    """Make a player run a command. Raises InputError if no player listens, or if the command failed."""
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(PATIENCE_S)
            connection.connect(str(control))
            connection.sendall(encode({"command": list(command), "request_id": 1}))
            answer = _answer(connection)
    except (OSError, ValueError) as error:
        raise InputError(f"{control}: no answer ({one_line(error)}); {FIX}") from None
    if answer.get("error") != "success":
        told = answer.get("message", answer.get("error"))
        raise InputError(f"{control}: the player could not {command[0]}: {shown(told)}")


def _answer(connection: socket.socket) -> dict[str, object]:
    """Return the answer among the received lines, which may include events."""
    waiting = b""
    while more := connection.recv(4096):
        *lines, waiting = (waiting + more).split(b"\n")
        for line in lines:
            answer = json.loads(line)
            if isinstance(answer, dict) and answer.get("request_id") == 1 and "error" in answer:
                return answer
        if len(waiting) > LONGEST:
            break
    return {"error": "it hung up"}
