"""Open Sound Control over UDP: the same commands and properties, by address.

    /counterlight/set/NAME VALUE       sets a property; a number also sets a flag, and is rounded for an integer
    /counterlight/share/NAME 0..1      sets a property to a share of its range or choices; a flag is on from 0.5
    /counterlight/get/NAME             is answered with /counterlight/NAME VALUE
    /counterlight/command/NAME …       runs a command; a result is answered with /counterlight/command/NAME RESULT

An error is answered with /counterlight/error TEXT. The time tag of a bundle is ignored.
"""

import asyncio
import json
import math
from collections.abc import Sequence
from typing import Any, TypeAlias, cast

from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

from counterlight.remote.link import Answer, Link

ROOT = "/counterlight"
MOST_WAITING = 256  # most waiting messages; further messages are lost, as with any datagram
LONGEST_TEXT = 1200  # bytes of an answer: one packet on any network, too short for a reflection attack
MOST_MESSAGES = 64  # most messages per packet
SMALLEST_INTEGER, LARGEST_INTEGER = -(2**31), 2**31 - 1

Sender: TypeAlias = tuple[Any, ...]


class UnreadError(ValueError):
    """An invalid address or argument. The message states what was expected."""


class Osc(asyncio.DatagramProtocol):
    """Runs OSC messages and sends each answer to the sender."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._arrived: asyncio.Queue[tuple[str, list[object], Sender]] = asyncio.Queue(MOST_WAITING)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, sender: Sender) -> None:
        for message in messages_of(data):
            if not self._arrived.full():
                self._arrived.put_nowait((message.address, list(message.params), sender))

    async def run(self) -> None:
        """Run the received messages in order."""
        while True:
            address, arguments, sender = await self._arrived.get()
            self._reply(sender, *await self._outcome(address, arguments))

    async def _outcome(self, address: str, arguments: Sequence[object]) -> tuple[str, object]:
        """Return the address and the value of the answer. The address is "" for no answer."""
        try:
            what, name = _parts(address)
            answer = await self._link.ask(*self._words(what, name, arguments))
        except UnreadError as error:
            return f"{ROOT}/error", f"{address[:80]}: {error}"
        if answer["error"] != "success":
            return f"{ROOT}/error", f"{address[:80]}: {answer.get('message', answer['error'])}"
        if what == "get":
            return f"{ROOT}/{name}", answer["data"]
        return f"{ROOT}/command/{name}" if answer["data"] is not None else "", answer["data"]

    def _words(self, what: str, name: str, arguments: Sequence[object]) -> list[object]:
        """Return the request for the control socket."""
        if what == "command":
            if name not in self._link.commands:
                raise UnreadError("no such command")
            return [name, *map(_plain, arguments)]
        info = self._link.properties.get(name)
        if info is None:
            raise UnreadError("no such property")
        if what == "get":
            return ["get_property", name]
        if len(arguments) != 1:
            raise UnreadError(f"expected one value, found {len(arguments)}")
        return ["set_property", name, (value_of if what == "set" else share_of)(info, arguments[0])]

    def _reply(self, sender: Sender, address: str, value: object) -> None:
        if address:
            self._transport.sendto(reply(address, value), sender)


def messages_of(packet: bytes) -> list[OscMessage]:
    """Return the messages of a packet. Empty if the packet is not OSC."""
    try:
        return [timed.message for timed in OscPacket(packet).messages[:MOST_MESSAGES]]
    except Exception:  # python-osc raises many kinds of errors for malformed packets
        return []


def value_of(info: Answer, argument: object) -> object:
    """Convert an argument to the property's type. Faders and knobs send 32-bit numbers for every type."""
    if not isinstance(argument, bool) and isinstance(argument, int | float) and math.isfinite(argument):
        if info["type"] == "flag":
            return argument > 0
        if info["type"] == "integer":
            return round(argument)
        if info["type"] == "number":
            return float(f"{argument:.7g}")  # 7 digits, because 0.1 in 32 bits is 0.10000000149
    return _plain(argument)


def share_of(info: Answer, argument: object) -> object:
    """Return the value at a share, from 0 to 1, of a property's range or choices."""
    share = argument if isinstance(argument, int | float) else math.nan
    if not 0 <= share <= 1:
        raise UnreadError(f"expected a share from 0 to 1, found {_plain(argument)!r}")
    if info["type"] == "flag":
        return share >= 0.5
    if info["type"] == "choice":
        return info["choices"][round(share * (len(info["choices"]) - 1))]
    if info["type"] == "any" or info["max"] is None:
        raise UnreadError("has no range to share; use set")
    return value_of(info, info["min"] + share * (info["max"] - info["min"]))


def reply(address: str, value: object) -> bytes:
    """Encode a message with one value: a number, a flag as 1 or 0, nothing for null, JSON for lists and tables."""
    builder = OscMessageBuilder(address)
    if isinstance(value, bool):
        builder.add_arg(int(value), "i")
    elif isinstance(value, int) and SMALLEST_INTEGER <= value <= LARGEST_INTEGER:
        builder.add_arg(value, "i")
    elif isinstance(value, int | float):
        builder.add_arg(float(value), "f")
    elif value is not None:
        text = value if isinstance(value, str) else json.dumps(value)
        builder.add_arg(text.replace("\0", "").encode(errors="replace")[:LONGEST_TEXT].decode(errors="ignore"), "s")
    return bytes(builder.build().dgram)


def _parts(address: str) -> tuple[str, str]:
    """Split `/counterlight/set/brightness` into set, brightness."""
    parts = address.split("/")
    if len(parts) != 4 or parts[1] != ROOT[1:] or parts[2] not in ("set", "share", "get", "command"):
        raise UnreadError(f"expected {ROOT}/set|share|get|command/NAME")
    return parts[2], parts[3]


def _plain(argument: object) -> object:
    """Return the argument if JSON can represent it. Raises UnreadError otherwise."""
    if argument is None or isinstance(argument, bool | int | float | str):
        return argument
    raise UnreadError("expected numbers, text, true, false or nothing")
