"""The main work of the decoder process: decodes a source lap after lap into the slots of the ring."""

import mmap
import os
import threading
import time
from typing import Any, NoReturn

import av

from counterlight.errors import InputError
from counterlight.media.decoding.child import limit_memory
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.decoding.mailbox import Events, Mailbox, Order
from counterlight.media.decoding.media import open_source
from counterlight.media.decoding.opening import log_natively
from counterlight.media.decoding.pixels import store
from counterlight.media.decoding.source import FormatChangedError, Source
from counterlight.media.frames import MediaInfo, describe_info, slot_bytes, slot_planes
from counterlight.media.medium import Medium

RING_SLOTS = 8
LIVE_SLOTS = 3
RING_BYTES = 512 << 20  # most bytes for decoding ahead; two slots may exceed this limit


def decode(arguments: dict[str, Any], mailbox: Mailbox, events: Events) -> None:
    """Open a medium and decode it until the process gets the order to quit.

    arguments : medium, loop, frames_per_second, tolerant, hwdec, start (the first order), ring (a file descriptor).
    """
    log_natively(av.logging.PANIC)
    hwdec = arguments["hwdec"]
    if hwdec != PROCESSOR:
        limit_memory(float("inf"))  # GPU drivers map more memory than exists
    try:
        medium = Medium(**arguments["medium"])
        source = open_source(medium, arguments["frames_per_second"], tolerant=arguments["tolerant"], hwdec=hwdec)
        planes = _make_ring(arguments["ring"], source.info)
    except InputError as error:
        events.send({"error": str(error)})
        _wait_for_the_end()
    mailbox.offer(len(planes))
    events.send({"opened": describe_info(source.info) | {"notices": source.notices}, "slots": len(planes)})
    order = Order(**arguments["start"])
    while True:
        order = _follow(order, source, planes, mailbox, events, loop=arguments["loop"] and not source.info.still)


def _make_ring(descriptor: int, info: MediaInfo) -> list[Any]:
    """Allocate all slots for a medium. Allocation in advance avoids a later SIGBUS when memory is full."""
    size = slot_bytes(info.format)
    slots = 1 if info.still else max(2, min(LIVE_SLOTS if info.live else RING_SLOTS, RING_BYTES // size))
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, slots * size)
        os.ftruncate(descriptor, slots * size)
        ring = mmap.mmap(descriptor, slots * size)
    except OSError as error:
        room = f"no room for {slots * size >> 20} MiB of decoded frames ({error.strerror})"
        raise InputError(f"{info.path}: {room}; free some memory, or scale it down") from None
    return [slot_planes(ring, info.format, slot) for slot in range(slots)]


def _follow(order: Order, source: Source, planes: list[Any], mailbox: Mailbox, events: Events, *, loop: bool) -> Order:
    """Send the ordered frames, lap after lap if `loop`. Returns the next order."""
    try:
        while _play_lap(order, source, planes, mailbox, events):
            if not loop:
                events.send({"end": True, "serial": order.serial})
                break
            order = Order(order.serial, 0.0, False, order.offset_s + source.end_s)
    except FormatChangedError as change:
        events.send({"changed": str(change)})
        _wait_for_the_end()
    except InputError as error:
        events.send({"error": str(error), "serial": order.serial})
    return mailbox.wait_for_order()


def _play_lap(order: Order, source: Source, planes: list[Any], mailbox: Mailbox, events: Events) -> bool:
    """Send the frames from `order.time_s` to the end. Returns False if a new order interrupts."""
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
        if slot is None and live:  # the player is busy, and a live source must not wait
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
            times |= {"offset_s": order.offset_s, "lap_s": source.end_s}  # 0 until the length of the first lap is known
            events.send({"frame": times | {"slot": slot, "skipped": skipped}, "serial": order.serial})
            skipped = 0
        asked = time.perf_counter()
    return True


def _wait_for_the_end() -> NoReturn:
    """Wait until the parent closes its pipe, which ends the process."""
    threading.Event().wait()
    raise AssertionError
