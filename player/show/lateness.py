"""Reports, once per medium, why frames are late and what to change."""

from counterlight.show.stats import Stats

WATCHED_S = 5.0  # shortest time that a medium is watched before a report
DROPPED_SHARE = 0.2  # share of dropped frames that causes a report


class Lateness:
    """Watches one medium.

    stats : counts of the whole show, including earlier media.
    rate : frames per second of the medium.
    began_s : clock time at which the medium began.
    """

    def __init__(self, stats: Stats, rate: float, began_s: float) -> None:
        self._stats, self._rate, self._began_s = stats, rate, began_s
        self._before = stats.frames, stats.dropped
        self._said = False

    def advice(self, now_s: float, steps: int, every: int, *, adapts: bool) -> str | None:
        """Return a line, once, if too many frames were dropped and not every frame is shown.

        now_s : clock time.
        steps : steps of refinement per frame.
        every : n, if every n-th frame is shown.
        adapts : whether the player chooses the steps itself, so that the user need not.
        """
        if self._said or now_s - self._began_s < WATCHED_S:
            return None
        shown, dropped = self._stats.frames - self._before[0], self._stats.dropped - self._before[1]
        if every == 1 or dropped < DROPPED_SHARE * (shown + dropped):
            return None
        self._said = True
        stages = {stage: self._stats.median_ms(stage) for stage in ("decode", "upload", "gpu", "present")}
        slowest = max(stages, key=lambda stage: stages[stage])
        words, remedy = {
            "decode": ("decoding", "play a smaller medium, or one of a lower rate"),
            "upload": ("uploading", "play a smaller medium"),
            "gpu": ("drawing", _lighter(0 if adapts else steps)),
            "present": ("the display", "try --no-vsync, or a medium of the display's rate"),
        }[slowest]
        made = f" with {steps} step{'s' * (steps > 1)}" if steps and words == "drawing" else ""
        return (
            f"not every frame can be shown in time ({shown} of {shown + dropped} so far): {words} takes "
            f"{stages[slowest]:.0f} ms{made}, a frame lasts {1000 / self._rate:.0f}; "
            f"every {ordinal(every)} frame is shown; {remedy}"
        )


def ordinal(number: int) -> str:
    """Return "2nd", "3rd", "4th", "11th", "21st"."""
    ending = "th" if number // 10 % 10 == 1 else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _lighter(steps: int) -> str:
    if steps:
        return f"take fewer steps of refinement than {steps} (--refine auto, key [)"
    return "build smaller maps (counterlight build --max-error 2), play at a lower rate, or on a faster GPU"
