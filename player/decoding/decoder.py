"""The decoder process: `python -m player.decoding.decoder ARGUMENTS`, started by player/video.py alone.

Reads commands (JSON lines) from stdin and writes events to stdout:

    in   {"ring": path, "slots": n}   {"free": slot}   {"seek": order}   {"quit": true}   end of file = quit
         {"skip": seconds, "serial": n}   (pictures that end before that time are no longer wanted)
    out  {"opened": {…}}   {"mapped": true}   {"frame": {…}, "serial": n}   {"end": true, "serial": n}
         {"error": line, "serial": n}   {"notice": line}
         {"busy_s": seconds}   (the heartbeat: time spent on the current picture)
"""

import json
import mmap
import os
import signal
import sys
import threading
import time
import traceback
from dataclasses import dataclass
from typing import IO, Any

import av

from player.decoding.ffmpeg_log import log_natively
from player.decoding.media import open_source
from player.decoding.pixels import store
from player.decoding.source import Source
from player.errors import InputError
from player.frames import PixelFormat, describe_info, slot_planes

HEARTBEAT_S = 0.5
MAX_ADDRESS_SPACE = 6 << 30


@dataclass(frozen=True)
class Order:
    """Where to start: the medium's time, whether strictly after it, and what to add to the times that are sent."""

    serial: int
    time_s: float
    after: bool
    offset_s: float


class Mailbox:
    """Commands as they arrive on stdin: free slots, the ring, the latest order. Quits the process on request."""

    def __init__(self, commands: IO[bytes]) -> None:
        self._commands = commands
        self._changed = threading.Condition()
        self._free: list[int] = []
        self._ring: str | None = None
        self._order: Order | None = None
        self._skip = (0, 0.0)
        self._working_since: float | None = time.monotonic()
        threading.Thread(target=self._listen, daemon=True).start()

    def wait_for_ring(self) -> tuple[str, int]:
        with self._changed:
            self._wait(lambda: self._ring is not None)
            assert self._ring is not None
            return self._ring, len(self._free)

    def wait_for_slot(self) -> int | None:
        """A free slot, or None when a new order has come."""
        with self._changed:
            self._wait(lambda: bool(self._free) or self._order is not None)
            return None if self._order is not None else self._free.pop(0)

    def take_slot(self) -> int | None:
        """A slot that is free at present."""
        self.is_alive()
        with self._changed:
            return self._free.pop(0) if self._free else None

    def is_alive(self) -> None:
        """Something has happened: the work that the heartbeat times begins anew."""
        self._working_since = time.monotonic()

    def put_back(self, slot: int) -> None:
        with self._changed:
            self._free.insert(0, slot)

    def is_overtaken(self, serial: int, end_s: float) -> bool:
        """Whether a picture that ends at `end_s` comes too late for whoever gave the order `serial`."""
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

    def _wait(self, condition: Any) -> None:
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
        # Whatever the codecs are doing: the parent has gone or wants us gone, and the kernel cleans up.
        os._exit(0)

    def _take(self, command: dict[str, Any]) -> None:
        if "free" in command:
            self._free.append(command["free"])
        elif "ring" in command:
            self._ring, self._free = command["ring"], list(range(command["slots"]))
        elif "seek" in command:
            self._order = Order(**command["seek"])
        elif "skip" in command:
            self._skip = command["serial"], command["skip"]


class Events:
    """Lines to the parent, from any thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._lock = stream, threading.Lock()

    def send(self, event: dict[str, Any]) -> None:
        with self._lock:
            self._stream.write(json.dumps(event).encode() + b"\n")
            self._stream.flush()


def main(arguments: dict[str, Any]) -> None:
    """Open the medium, wait for the ring, then follow orders until told to quit."""
    events = Events(private_stdout())
    mailbox = Mailbox(sys.stdin.buffer)
    threading.Thread(target=_beat, args=(events, mailbox), daemon=True).start()
    try:
        source = open_source(arguments["path"], arguments["frames_per_second"], tolerant=arguments["tolerant"])
    except InputError as error:
        events.send({"error": str(error)})
        threading.Event().wait()  # until the parent closes stdin
        raise AssertionError from None
    events.send({"opened": describe_info(source.info) | {"notices": source.notices}})
    path, slots = mailbox.wait_for_ring()
    planes = _map_ring(path, slots, source.info.format)
    events.send({"mapped": True})
    order = Order(**arguments["start"])
    while True:
        order = _follow(order, source, planes, mailbox, events, loop=arguments["loop"] and not source.info.still)


def _follow(order: Order, source: Source, planes: list[Any], mailbox: Mailbox, events: Events, *, loop: bool) -> Order:
    """Send frames as ordered, lap after lap if `loop`; returns the next order."""
    try:
        while _play_lap(order, source, planes, mailbox, events):
            if not loop:
                events.send({"end": True, "serial": order.serial})
                break
            order = Order(order.serial, 0.0, False, order.offset_s + source.end_s)
    except InputError as error:
        events.send({"error": str(error), "serial": order.serial})
    return mailbox.wait_for_order()


def _play_lap(order: Order, source: Source, planes: list[Any], mailbox: Mailbox, events: Events) -> bool:
    """Send the frames from `order.time_s` to the end; False when a new order interrupts."""
    asked, skipped, live = time.perf_counter(), 0, source.info.live
    for picture in source.lap(order.time_s, after=order.after):
        if isinstance(picture, str):
            mailbox.is_alive()
            if picture:
                events.send({"notice": picture})
            continue
        if picture.corrupt:
            mailbox.is_alive()
            skipped += 1
            continue
        decode_s = time.perf_counter() - asked
        slot = mailbox.take_slot() if live else mailbox.wait_for_slot()
        if slot is None and live:  # whoever shows it is busy: the source must not wait
            skipped += 1
            continue
        if slot is None:
            return False
        if mailbox.is_overtaken(order.serial, order.offset_s + picture.time_s + picture.duration_s):
            mailbox.put_back(slot)
            skipped += 1
        else:
            store(picture.samples, planes[slot], flip_rows=source.flip_rows)
            times = {"time_s": picture.time_s, "duration_s": picture.duration_s, "decode_s": decode_s}
            times |= {"offset_s": order.offset_s, "lap_s": source.end_s}  # 0 until the first lap's length is known
            events.send({"frame": times | {"slot": slot, "skipped": skipped}, "serial": order.serial})
            skipped = 0
        asked = time.perf_counter()
    return True


def _map_ring(path: str, slots: int, pixels: PixelFormat) -> list[Any]:
    with open(path, "r+b") as file:
        ring = mmap.mmap(file.fileno(), 0)
    return [slot_planes(ring, pixels, slot) for slot in range(slots)]


def _beat(events: Events, mailbox: Mailbox) -> None:
    while True:
        time.sleep(HEARTBEAT_S)
        events.send({"busy_s": mailbox.busy_s()})


def private_stdout() -> IO[bytes]:
    """Keep the pipe to the parent for events: libraries print warnings to file descriptor 1."""
    pipe = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    return os.fdopen(pipe, "wb")


def limit_memory() -> None:
    """Bound the address space, so that a hostile header fails here and does not swap the machine to death."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = MAX_ADDRESS_SPACE if hard == resource.RLIM_INFINITY else min(MAX_ADDRESS_SPACE, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    log_natively(av.logging.PANIC)
    try:
        main(json.loads(sys.argv[1]))
    except BrokenPipeError:  # the parent has gone
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        # An orderly exit would wait for the thread that reads stdin, and abort.
        os._exit(1)
