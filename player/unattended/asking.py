"""Sends one command to a player's control socket and returns its answer."""

import json
import socket
from pathlib import Path

from counterlight.errors import InputError, one_line, shown
from counterlight.unattended.json_lines import encode

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
