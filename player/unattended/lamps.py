"""Projectors (PJLink) that a show's remotes can observe and switch. The show never waits for a projector."""

import threading
from collections.abc import Sequence
from typing import Any

from counterlight.errors import InputError
from counterlight.unattended.pjlink import POWERS, Projector, Status, status_of, switch

# time between two queries: of a projector that is on or off, and of one that warms up or cools down
LOOK_S, AGAIN_S = 60.0, 5.0


class Lamps:
    """Switches and queries projectors, each in its own thread."""

    def __init__(self, projectors: Sequence[Projector]) -> None:
        self._lamps = [_Lamp(projector) for projector in projectors]

    def told(self) -> list[dict[str, Any]]:
        """Return each projector's address, power (of POWERS, null if unknown), lamp hours, faults and trouble."""
        return [lamp.told() for lamp in self._lamps]

    def __len__(self) -> int:
        return len(self._lamps)

    def switch(self, number: int | None, *, on: bool) -> None:
        """Order projectors to be switched.

        number : number of the projector, from 0; None for all.
        on : whether to switch on.
        """
        for lamp in self._lamps if number is None else [self._lamps[number]]:
            lamp.switch(on)

    def close(self) -> None:
        for lamp in self._lamps:
            lamp.close()


class _Lamp:
    def __init__(self, projector: Projector) -> None:
        self._projector = projector
        self._status: Status | None = None
        self._trouble: str | None = None
        self._wanted: bool | None = None
        self._awake = threading.Event()
        self._closed = False
        threading.Thread(target=self._run, name=f"lamp {projector}", daemon=True).start()

    def told(self) -> dict[str, Any]:
        known = self._status
        return {
            "address": str(self._projector),
            "power": None if known is None else known.power,
            "lamp-hours": [] if known is None else list(known.lamp_hours),
            "faults": [] if known is None else list(known.faults),
            "trouble": self._trouble,
        }

    def switch(self, on: bool) -> None:
        self._wanted = on
        self._awake.set()

    def close(self) -> None:
        self._closed = True
        self._awake.set()

    def _run(self) -> None:
        while not self._closed:
            self._awake.clear()
            try:
                self._look()
                self._trouble = None
            except InputError as error:
                self._status, self._trouble = None, str(error).removeprefix(f"projector {self._projector}: ")
            settled = self._wanted is None and self._status is not None and self._status.settled
            self._awake.wait(LOOK_S if settled else AGAIN_S)

    def _look(self) -> None:
        """Query the projector, and send the order that is still missing."""
        self._status, wanted = status_of(self._projector), self._wanted
        if wanted is not None and self._status.settled:
            if self._status.power != POWERS[wanted]:
                switch(self._projector, on=wanted)
                self._status = status_of(self._projector)
            if self._wanted is wanted:
                self._wanted = None
