"""The properties of refinement: its steps, their cost, and the distance from the best picture."""

from collections.abc import Callable
from operator import attrgetter
from typing import Any

from counterlight.pipeline.refinement import Certificate
from counterlight.show.registry import CommandError, Property, named
from counterlight.show.session import Session

UNREFINABLE = "no refinement: the maps were built without it; counterlight build adds it"


def refining(session: Session) -> dict[str, Property]:
    """Return the properties of a session's refinement."""
    governor, appraisal = session.governor, session.appraisal

    def wants(what: Any) -> None:
        if what not in (0, "no") and not session.room.refinable:
            raise CommandError(UNREFINABLE)
        session.changed()

    def refine(steps: Any) -> None:
        wants(steps)
        governor.set_refine(steps)

    def budget(milliseconds: Any) -> None:
        wants(milliseconds)
        governor.set_budget(milliseconds)

    def within(decibels: Any) -> None:
        wants(decibels)
        governor.set_within(decibels)

    def certified(value: Callable[[Certificate], float]) -> float | None:
        certificate = session.certificate()
        return None if certificate is None else value(certificate)

    def below_optimum() -> float | None:
        found = appraisal.ask()
        return None if found is None else found.decibels

    def doubling() -> dict[str, float | None] | None:
        found = appraisal.ask()
        return (
            None
            if found is None
            else {"steps": found.further, "db": found.doubling, "ms": governor.took_ms(found.further)}
        )

    psnr = session.room.psnr
    return {
        "refine": named("refine", lambda: governor.refine, refine),
        "budget": named("budget", lambda: governor.budget, budget),
        "within": named("within", lambda: governor.within, within),
        "steps": Property("number of refinement steps of the picture on the screen", lambda: session.steps_made),
        "step-ms": Property("milliseconds per refinement step; null if unknown", lambda: governor.took_ms(1)),
        "below-optimum": Property(
            "estimated distance to the best picture in dB; null while unknown", below_optimum, costly=True
        ),
        "doubling": Property(
            "object with the gain in dB and the cost in ms of twice as many steps; null while unknown",
            doubling,
            costly=True,
        ),
        "gap": Property(
            "relative gap to the best picture; null if unknown",
            lambda: certified(attrgetter("relative")),
            costly=True,
        ),
        "psnr": Property(
            "PSNR of the predicted camera picture against the target, in dB; null if unknown",
            lambda: certified(psnr),
            costly=True,
        ),
    }
