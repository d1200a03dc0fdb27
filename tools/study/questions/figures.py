"""Steps, cuts and the size of entries, taken from the figures of the study's methods in a room."""

from collections.abc import Callable, Sequence

from counterlight.tools.study.questions.answers import CLOSE_DB, NEAR_DB, Answer, Question, cheapest, decibels, sentence
from counterlight.tools.study.results import Mean, Row, means
from counterlight.tools.study.tables import number

STEPPED = ("refined from direct", "refined from T⁺, cut", "refined from T⁺")
MAPPED = ("T⁺, cut", "T⁺", "T⁺ of the thesis", "direct")


def steps(rows: Sequence[Row]) -> Question:
    """Compare steps of refinement, by their start."""
    answers = _answers(rows, STEPPED, lambda mean: mean.picture_ms)
    found = cheapest(answers, CLOSE_DB)
    verdict = "no number of steps that was tried gets within 0.1 dB of the best"
    if found is not None:
        verdict = (
            f"the fastest within {CLOSE_DB:g} dB of the best: {found.setting}, {number(found.cost)} ms a frame, "
            f"{decibels(found.below)} below"
        )
    return Question(
        "Steps of refinement",
        "ms a frame",
        answers,
        sentence(verdict),
        "Means of the study's pictures, by the player.",
        ("commands",),
        "" if found is None else found.more[0],
    )


def maps(rows: Sequence[Row]) -> Question:
    """Compare smaller T⁺ without steps: cut into clusters, truncated, or with smaller entries."""
    answers = _answers(rows, MAPPED, lambda mean: mean.map_mib)
    found = cheapest(answers, NEAR_DB)
    best = min(answers, key=lambda answer: answer.below, default=None)
    verdict = "no map without steps comes within 1 dB of the best: let the player refine"
    if best is not None and found is not None:
        verdict = (
            f"without steps the smallest map within {NEAR_DB:g} dB is {found.setting}: {number(found.cost)} MiB, "
            f"{decibels(found.below)} below; the best, {best.setting}: {number(best.cost)} MiB, {decibels(best.below)}"
        )
    return Question(
        "Maps: cuts, truncation, size of entries",
        "MiB that a frame reads",
        answers,
        sentence(verdict),
        "Means of the study's pictures, by the player, no step.",
        ("commands",),
        "" if found is None else found.more[0],
    )


def _answers(rows: Sequence[Row], families: Sequence[str], cost: Callable[[Mean], float | None]) -> list[Answer]:
    found = [mean for mean in means(rows) if mean.family in families]
    found.sort(key=lambda mean: (families.index(mean.family), mean.value or 0.0))
    return [
        Answer(
            mean.label,
            cost(mean),
            max(mean.below_optimum_db, 0.0),
            (mean.command,),
            "" if mean.value is None else f"{mean.value:g}",
            mean.family,
        )
        for mean in found
    ]
