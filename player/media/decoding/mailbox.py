"""The decoder process's end of the pipes: receives commands and sends events as JSON lines (decoder.py lists them)."""

import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

HEARTBEAT_S = 0.5


@dataclass(frozen=True)
class Order:
    """Where to start.

    serial : number of the order.
    time_s : time in the medium.
    after : whether to start strictly after `time_s`.
    offset_s : added to the times that are sent.
    """

    serial: int
    time_s: float
    after: bool
    offset_s: float


class Mailbox:
    """The received commands: free slots and the latest order. Quits the process on request or when the parent ends."""

    def __init__(self, commands: IO[bytes]) -> None:
        self._commands = commands
        self._changed = threading.Condition()
        self._free: list[int] = []
        self._order: Order | None = None
        self._skip = (0, 0.0)
        self._working_since: float | None = time.monotonic()
        threading.Thread(target=self._listen, daemon=True).start()

    def offer(self, slots: int) -> None:
        """Set the number of slots, all of them free."""
        self._free = list(range(slots))

    def wait_for_slot(self) -> int | None:
        """Wait for a free slot. Returns None if a new order has come."""
        with self._changed:
            self._wait(lambda: bool(self._free) or self._order is not None)
            return None if self._order is not None else self._free.pop(0)

    def take_slot(self) -> int | None:
        """Return a free slot, None if there is none now."""
        self.is_alive()
        with self._changed:
            return self._free.pop(0) if self._free else None

    def is_alive(self) -> None:
        """Record progress: the heartbeat's time for the current work starts again."""
        self._working_since = time.monotonic()

    def put_back(self, slot: int) -> None:
        with self._changed:
            self._free.insert(0, slot)

    def is_overtaken(self, serial: int, end_s: float) -> bool:
        """Whether a picture that ends at `end_s` is too late for the order `serial`."""
        return self._skip[0] == serial and end_s <= self._skip[1]

    def wait_for_order(self) -> Order:
        with self._changed:
            self._wait(lambda: self._order is not None)
            order, self._order = self._order, None
            assert order is not None
            return order

    def busy_s(self) -> float:
        since = self._working_since
        return 0.0 if since is None else time.monotonic() - since

    def _wait(self, condition: Callable[[], bool]) -> None:
        self._working_since = None
        self._changed.wait_for(condition)
        self._working_since = time.monotonic()

    def _listen(self) -> None:
        for line in self._commands:
            command = json.loads(line)
            if "quit" in command:
                break
            with self._changed:
                self._take(command)
                self._changed.notify_all()
        # The parent has ended or requests the end. An immediate exit is safe, because the kernel cleans up.
        os._exit(0)

    def _take(self, command: dict[str, Any]) -> None:
        if "free" in command:
            self._free.append(command["free"])
        elif "seek" in command:
            self._order = Order(**command["seek"])
        elif "skip" in command:
            self._skip = command["serial"], command["skip"]


class Events:
    """Sends lines to the parent, from any thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._lock = stream, threading.Lock()

    def send(self, event: dict[str, Any]) -> None:
        with self._lock:
            self._stream.write(json.dumps(event).encode() + b"\n")
            self._stream.flush()

    def beat(self, mailbox: Mailbox) -> None:
        """Send a heartbeat now and every HEARTBEAT_S, without end."""
        while True:
            self.send({"busy_s": mailbox.busy_s()})
            time.sleep(HEARTBEAT_S)
