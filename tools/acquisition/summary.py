"""The report of an acquisition: what was measured, and warnings with remedies."""

from bisect import bisect
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import BoolArray
from counterlight.passes.encode import reached
from counterlight.response import Response, parse_response
from counterlight.tools.acquisition.acquire import Acquisition
from counterlight.tools.acquisition.ramps import CODES, ProjectorLight
from counterlight.tools.acquisition.room_options import ASSUMED_LINE
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.factoring.factoring import Factoring
from counterlight.tools.joining.shared_screen import Placed
from counterlight.tools.transport.interval import Expected

EVEN, LIFTED = 0.002, 0.5  # shares of white: smallest uneven black (code 7 of sRGB); highest level of black
SUSPECT = 3.0  # largest error of the check, in multiples of the camera's noise
# limit of the coloured check's unexplained error: this multiple of the first check's unexplained error, plus this
# margin
OFF_COLOUR = 2.0, 0.02
COVERED = 0.98  # share of the projector's pixels; a room with less coverage causes a warning
MOST_OTHER = 0.02  # share of white by which a given response may differ from the measured one


STEPS = np.linspace(0, 1, 17)  # code values per channel of a picture's colours
CORNERS = {
    "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1), "cyan": (0, 1, 1), "magenta": (1, 0, 1),
    "yellow": (1, 1, 0), "white": (1, 1, 1),
}  # fmt: skip


@dataclass(frozen=True)
class Unreachable:
    """Colours up to white that no code values of the projector give.

    share : share of a picture's colours, at equal steps of sRGB's code values.
    worst : the full colour that loses most, and the share of its light that arrives.
    white : share of white at which a picture's colours all arrive.
    """

    share: float
    worst: str
    arriving: float
    white: float

    @classmethod
    def of(cls, response: Response) -> "Unreachable":
        colours = np.stack(np.meshgrid(STEPS, STEPS, STEPS), axis=-1).reshape(1, -1, 3)
        light, full = parse_response("srgb").to_linear(colours), np.array([list(CORNERS.values())], float)
        arriving = np.min(reached(full, response.over(full.shape[:2])), axis=-1, initial=1, where=full > 0)[0]

        def missed(white: float) -> float:
            wanted = white * light
            return float(np.any(reached(wanted, response.over(light.shape[:2])) != wanted, axis=-1).mean())

        reachable = bisect(range(1, 101), 0.0, key=lambda percent: missed(percent / 100))  # a darker picture needs less
        worst = int(arriving.argmin())
        return cls(missed(1), list(CORNERS)[worst], float(arriving[worst]), reachable / 100)

    def __str__(self) -> str:
        return (
            f"{100 * self.share:.2g} % of a picture's colours need more light than the projector gives them; full "
            f"{self.worst} arrives at {100 * self.arriving:.0f} %; all colours arrive with --white at "
            f"{100 * self.white:.0f} % of the room's white level"
        )


@dataclass(frozen=True)
class LightOutside:
    """Light that the camera does not see.

    unseen : share of the projector's pixels whose light the camera does not see.
    white : share of full drive that a white picture leaves in these pixels; None if there are
        no such pixels, or if no white picture was tried.
    """

    unseen: float
    white: float | None

    def __str__(self) -> str:
        kept = "" if self.white is None else f"; a white picture keeps {100 * self.white:.1f} % of it lit"
        return f"{100 * self.unseen:.1f} % of the projector's light falls where the camera does not see it{kept}"


@dataclass(frozen=True)
class Black:
    """The darkest and brightest part of a captured black picture inside the mask, as shares of white."""

    least: float
    most: float

    def __str__(self) -> str:
        seen = f"{100 * self.least:.2g} to {100 * self.most:.2g} % of white"
        if self.most - self.least < EVEN or self.most > LIFTED:
            return seen
        return f"{seen}; counterlight play --black-level {np.ceil(1000 * self.most) / 1000:g} shows it even"


@dataclass(frozen=True)
class Coverage:
    """Projector pixels that some camera pixel sees; `seen` is (height, width)."""

    seen: BoolArray

    @property
    def share(self) -> float:
        return float(self.seen.mean())

    @property
    def warnings(self) -> list[str]:
        """Returns which pixels are missing, and the remedy; empty if nearly all are seen."""
        if self.share >= COVERED:
            return []
        rows, columns = (np.flatnonzero(self.seen.any(axis=axis)) for axis in (1, 0))
        height, width = self.seen.shape
        unseen = {
            "top": rows[0],
            "bottom": height - 1 - rows[-1],
            "left": columns[0],
            "right": width - 1 - columns[-1],
        }
        edges = ", ".join(f"{edge} {count}" for edge, count in unseen.items() if count)
        inside = float(1 - self.seen[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].mean())
        said = f"coverage: the camera sees {100 * self.share:.1f} % of the projector's pixels, expected "
        said += f"{100 * COVERED:.0f} % or more, and the others stay dark"
        if edges:
            said += f"; it misses pixels at the edges ({edges}): {WIDER}"
        if inside > 1 - COVERED:
            said += f"; it misses {100 * inside:.1f} % of the pixels in between: {CLOSER}"
        return [f"{said}; then acquire again with --force"]


@dataclass(frozen=True)
class ProjectorReport:
    """The measurements of one projector.

    given : response that replaces the measured one, if any.
    factoring : the factors that replace a dense T.
    """

    acquisition: Acquisition
    given: Response | None
    factoring: Factoring
    coverage: Coverage

    @property
    def taken(self) -> list[str]:
        """Lines about pictures, exposures and noise."""
        done = self.acquisition
        resumed = f", {done.resumed} of them from before" if done.resumed else ""
        noise = 100 * float(np.max(done.room.noise.dark)) / float(np.max(done.room.floodlight))
        return [
            *done.measured.notes,
            f"{done.pictures} pictures, {done.exposures} exposures{resumed}, {done.seconds:.1f} s; noise of a dark "
            f"capture {noise:.2g} % of the brightest",
            *([str(done.averaged)] if done.averaged else []),
            *([f"camera: {done.curve}"] if done.curve else []),
            *([f"camera: {done.wander}"] if done.wander and done.wander.is_worth_a_line else []),
        ]

    @property
    def light(self) -> list[str]:
        """Lines about response, black and primaries."""
        room, light = self.acquisition.room, self.acquisition.light
        response = "response: as given" if self.given else f"response: {light.fit}" if light else ASSUMED_LINE
        lit = ~room.saturated & np.any(room.floodlight - room.black > room.floodlight.max() / 10, axis=2)
        contrast = float(room.floodlight[lit].mean() / max(room.black[lit].mean(), np.finfo(float).tiny))
        said = [response, f"contrast: white is {contrast:.3g} times as bright as black and the room's light"]
        if light and light.response.segment:
            white = float(light.response.segment.white().mean())
            said.append(
                f"colour: grey is up to {100 * (white - 1):.0f} % brighter than its red, green and blue: a white "
                f"segment, which is taken out, so that white is {100 / white:.0f} % of the projector's; "
                f"{100 * light.crosstalk:.1f} % of a camera channel's light is its neighbours'"
            )
        elif light and light.response.processing:
            factors = np.array(light.response.processing.samples)
            said.append(
                f"colour: the light of a primary depends on the other codes, from {100 * factors.min():.0f} to "
                f"{100 * factors.max():.0f} % of its share of white, which is taken out; "
                f"{100 * light.crosstalk:.1f} % of a camera channel's light is its neighbours'"
            )
        elif light:
            apart = 100 * float(np.abs(light.unadded).max())
            said.append(
                f"colour: red, green and blue add up to grey within {apart:.2g} % of white; "
                f"{100 * light.crosstalk:.1f} % of a camera channel's light is its neighbours'"
            )
        if light and (missed := Unreachable.of(light.curve(self.given) if self.given else light.response)).share:
            said.append(f"unreachable: {missed}")
        return said

    @property
    def checks(self) -> list[str]:
        """Lines about the prediction of random pictures."""
        done = self.acquisition
        said = [f"check: {done.check.of} is predicted to {done.check}"]
        if colours := done.of_colours:
            said.append(f"check: {colours.of} are predicted to {colours}")
        return said

    @property
    def suspect(self) -> bool:
        """Whether the prediction is much worse than noise explains."""
        return self.acquisition.check.error > SUSPECT * self.acquisition.check.noise + 0.05

    @property
    def off_colour(self) -> bool:
        """Whether the prediction is much worse than noise explains."""
        (times, more), check, colours = OFF_COLOUR, self.acquisition.check, self.acquisition.of_colours
        return colours is not None and colours.excess > times * check.excess + more

    @property
    def warnings(self) -> list[str]:
        """Lines about what a user should fix."""
        light = self.acquisition.light
        of_light = [] if light is None or light.is_explained else [_not_adding(light)]
        of_light += self._other_response()
        if self.off_colour and not of_light:
            of_light.append(OFF)
        return [*self.coverage.warnings, *([SCATTERED] if self.suspect else []), *of_light]

    def _other_response(self) -> list[str]:
        """Returns a line on the error that a given response adds to the measured one; empty if they agree."""
        done = self.acquisition
        if not (self.given and done.light and done.coloured and done.by_measured):
            return []
        codes = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
        given = done.light.curve(self.given)
        apart = float(np.abs(given.to_linear(codes) - done.light.response.to_linear(codes)).max())
        if apart <= MOST_OTHER:
            return []
        return [
            f"the given response is up to {100 * apart:.0f} % of white from the measured one: it predicts greys and "
            f"colours to {100 * done.coloured.error:.1f} %, the measured one to {100 * done.by_measured.error:.1f} %; "
            "leave out --response (with --force --reuse-captures no picture is taken again)"
        ]


@dataclass(frozen=True)
class AcquisitionReport:
    """The report of an acquisition; its text is the command's output with --verbose.

    masked, camera_pixels : camera pixels in the mask, and in total.
    entries : near entries per channel.
    outside : light that a compensated picture leaves where the camera does not see it.
    black : captured black of several projectors, whose black levels add up where they overlap.
    colours : lines on projectors that show primaries of others.
    placed : lines on the place of each of several cameras on the screen.
    expected : how well captures match the prediction; None without random pictures that were held back.
    """

    projectors: tuple[ProjectorReport, ...]
    masked: int
    camera_pixels: int
    entries: int
    clusters: Clusters
    outside: LightOutside | None = None
    black: Black | None = None
    colours: tuple[str, ...] = ()
    placed: tuple[Placed, ...] = ()
    expected: Expected | None = None

    def __str__(self) -> str:
        return "\n".join(self.lines(verbose=True))

    def lines(self, *, verbose: bool) -> list[str]:
        """Returns the lines of the report; `verbose` includes the clusters."""
        sizes = self.clusters.projector_sizes
        clusters = f"clusters: {self.clusters.count}, the largest of {sizes.max(initial=0)} projector pixels"
        whose = "projector's" if len(self.projectors) == 1 else "projectors'"
        return [
            *([str(self.expected)] if self.expected else []),
            *self._of_each(lambda each: each.taken),
            f"coverage: {100 * self.covered:.1f} % of the {whose} pixels seen, {self.masked} of {self.camera_pixels} "
            "camera pixels in the mask",
            *([f"{clusters}; {self.entries} near entries a channel"] if verbose else []),
            *map(str, self.placed),
            *self._of_each(lambda each: [str(each.factoring)]),
            *([f"light outside: {self.outside}"] if self.outside else []),
            *([f"black: {self.black}"] if self.black else []),
            *self._of_each(lambda each: [*each.light, *each.checks]),
            *self.colours,
        ]

    @property
    def covered(self) -> float:
        """Share of the pixels of all projectors that some camera pixel sees."""
        return float(np.mean(np.concatenate([each.coverage.seen.ravel() for each in self.projectors])))

    @property
    def warnings(self) -> list[str]:
        """Lines about what a user should fix."""
        return self._of_each(lambda each: each.warnings)

    def _of_each(self, lines: Callable[[ProjectorReport], list[str]]) -> list[str]:
        """Returns the lines of every projector, with its name if there are several."""
        if len(self.projectors) == 1:
            return lines(self.projectors[0])
        return [f"projector {number}: {line}" for number, each in enumerate(self.projectors, 1) for line in lines(each)]


WIDER = "turn the camera, zoom out or step back until it sees a margin around the picture (--preview shows it)"
CLOSER = (
    "give the camera as many pixels as the projector in the picture (zoom in, step closer, larger files), and expose "
    "longer where the picture is dark"
)
SCATTERED = (
    "the check is far off what noise explains; light may reach some camera pixels from several places (use "
    "--scheme hierarchical), or be too weak (longer exposures, lower --threshold)"
)
OFF = (
    "greys and colours are predicted clearly worse than black and white: the projector's light depends on the whole "
    "picture or on time (switch off dynamic contrast, colour enhancement and lamp saving), or --camera-response is not "
    "the camera's; what is played will be off as much"
)


def _not_adding(light: ProjectorLight) -> str:
    worst = int(np.abs(light.unadded).argmax())
    more = 100 * float(light.unadded[worst])
    return (
        f"the projector's light does not add up: grey of code {CODES[worst]} is {abs(more):.0f} % of white "
        f"{'brighter' if more > 0 else 'darker'} than red, green and blue of that code together, which no response "
        "describes; switch off its white segment (brilliant colour), colour enhancement, dynamic contrast and lamp "
        "saving, lock the camera's exposure, check --camera-response, and acquire again with --force"
    )
