"""A network wire that delays datagrams and loses some."""

import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from heapq import heappop, heappush


class Wire:
    """Passes datagrams from `port` to `target`, and the answers back.

    delay_s : least and largest delay in each direction, drawn per datagram, so that datagrams may overtake each other.
    loss : share of lost datagrams in each direction.
    cut : True drops everything.
    """

    def __init__(self, target: int, delay_s: tuple[float, float], loss: float, seed: int = 1) -> None:
        self._delay_s, self._loss, self._random = delay_s, loss, random.Random(seed)
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self._far.connect(("127.0.0.1", target))
        self.port = int(self._near.getsockname()[1])
        self.cut = self._closed = False
        self.lost = self.passed = 0
        self._client: tuple[str, int] | None = None
        self._under_way: list[tuple[float, int, bytes, bool]] = []
        self._lock = threading.Condition()
        self._threads = [threading.Thread(target=self._receive, args=(out,), daemon=True) for out in (True, False)]
        self._threads.append(threading.Thread(target=self._deliver, daemon=True))
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._closed = True
        with self._lock:
            self._lock.notify()
        for thread in self._threads:
            thread.join()
        self._near.close()
        self._far.close()

    def _receive(self, out: bool) -> None:
        link = self._near if out else self._far
        link.settimeout(0.05)
        while not self._closed:
            with suppress(OSError):
                data, sender = link.recvfrom(2048)
                self._client = sender if out else self._client
                if self.cut or self._random.random() < self._loss:
                    self.lost += 1
                    continue
                with self._lock:
                    self.passed += 1
                    due_s = time.monotonic() + self._random.uniform(*self._delay_s)
                    heappush(self._under_way, (due_s, self.passed, data, out))
                    self._lock.notify()

    def _deliver(self) -> None:
        while not self._closed:
            with self._lock:
                wait_s = self._under_way[0][0] - time.monotonic() if self._under_way else 0.05
                if wait_s > 0 or not self._under_way:
                    self._lock.wait(min(wait_s, 0.05))
                    continue
                _, _, data, out = heappop(self._under_way)
            with suppress(OSError):
                if out:
                    self._far.send(data)
                elif self._client is not None:
                    self._near.sendto(data, self._client)


@contextmanager
def wire(target: int, delay_s: tuple[float, float] = (0, 0), loss: float = 0, seed: int = 1) -> Iterator[Wire]:
    made = Wire(target, delay_s, loss, seed)
    try:
        yield made
    finally:
        made.close()
