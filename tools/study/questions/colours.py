"""Question: what does each tier of colour give in this room?"""

from counterlight.tools.choices import COLOURS
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question, decibels
from counterlight.tools.study.questions.place import Place

TRUE_TIER = "pixel"  # the most accurate tier, by which drives of all tiers are judged


def colours(place: Place) -> Question | None:
    """Show drives of every tier by the most accurate tier; None where no primaries were measured."""
    calibration, transport = place.calibration, place.transport
    if calibration.primaries is None:
        return None
    known = tier_of(calibration, transport, TRUE_TIER)
    whole = Place(calibration, transport, place.pictures, TRUE_TIER)
    answers = [
        Answer(name, None, max(whole.below(whole.drives(tier_of(calibration, transport, name))), 0.0), (), name)
        for name in COLOURS
        if name != "auto"
    ]
    return Question(
        "Tiers of colour",
        "",
        answers,
        _verdict(answers, place),
        f"Shown in the room as each camera pixel's floodlights of the primaries describe it ({known.reason}).",
        command="counterlight build --colour TIER",
    )


def _verdict(answers: list[Answer], place: Place) -> str:
    by_name = {answer.setting: answer.below for answer in answers}
    alone, one = by_name["independent"], by_name["global"]
    if alone < CLOSE_DB:
        return f"Channels may be taken for independent: that costs {decibels(alone)}."
    return (
        f"Channels that are taken for independent cost {decibels(alone)}, one mixing for the room {decibels(one)}; "
        f"--colour auto takes {place.tier.mixing.tier}."
    )
