"""One drive for several views: each view counts by its share.

With shares λ of sum 1, the steps minimise

    Σ λ (½ Σ w (T p − b)² + ½ pᵀP p),        0 ≤ p ≤ 1,

with T, b, w and P of each view (refinement.py). A step is the mean of the views' slopes, divided by the mean of their
curvatures. The start is the mean of the views' own starts. With one view, all means are that view's own values.
"""

from collections.abc import Sequence
from typing import Generic, TypeAlias

from counterlight.maps.prior import Prior
from counterlight.passes.certificate import Inverse
from counterlight.passes.combine import Blend
from counterlight.passes.drawing import Canvas, Picture
from counterlight.passes.refinement_step import Ties
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.room_view import RoomView, Target
from counterlight.pipeline.starts import GreyStart, Iterate, MapStart, PreviousStart, Start, standing

Targets: TypeAlias = Sequence[Target[Picture]]


class Mean(Owning, Generic[Picture]):
    """Computes Σ λ · picture over pictures of the projector's size. A single picture is returned as it is."""

    def __init__(self, device: Device[Picture], shape: tuple[int, int]) -> None:
        self._device, self._shape, self._owner = device, shape, Owner()
        self._canvases: list[Canvas[Picture]] = []

    def run(self, pictures: Sequence[tuple[float, Picture]]) -> Picture:
        """Return the mean of (share, picture) pairs; valid until the next call."""
        (total, mean), *others = pictures
        for number, (share, picture) in enumerate(others):
            total += share
            mean = self._canvas(number % 2).draw(Blend(mean, picture, share / total))
        return mean

    def _canvas(self, number: int) -> Canvas[Picture]:
        while len(self._canvases) <= number:
            self._canvases.append(self._owner.own(self._device.canvas(self._shape)))
        return self._canvases[number]


class ViewBlend(Owning, Generic[Picture]):
    """Makes drives for views.

    shape : (height, width) of the projector.
    refines : whether every view has the maps of refinement.
    """

    def __init__(self, device: Device[Picture], views: Sequence[RoomView[Picture]], shape: tuple[int, int]) -> None:
        self._device, self._shape, self._owner = device, shape, Owner()
        self.refines = all(view.refiner is not None for view in views)
        self._guesses, self._slopes, self._curvatures = (self._owner.own(Mean(device, shape)) for _ in range(3))
        self._starts: dict[str, Start[Targets[Picture], Picture]] = {}
        self._several: _Several[Picture] | None = None

    def start_from(self, start: str, bare: str = "map") -> None:
        """Set where refinement starts, one of STARTS.

        bare : the drive without steps: "map" for clamp(T⁺ b), or "direct" for direct mapping.
        """
        self._bare = bare if self.refines else "map"
        if self.refines:
            if start not in self._starts:
                self._starts[start] = self._owner.own(self._make_start(start))
            self._start = self._starts[start]

    def _make_start(self, start: str) -> Start[Targets[Picture], Picture]:
        if start == "grey":
            return GreyStart(self._device, self._shape)
        if start in ("direct", "map"):
            return MapStart(_Guessed(self._guesses, start, clamp=True))
        of = "direct" if start == "previous-direct" else "map"
        return PreviousStart(self._device, self._shape, _Guessed(self._guesses, of, clamp=False))

    def stand(self, shares: Sequence[tuple[float, RoomView[Picture]]]) -> None:
        """Use these (share, view) pairs from now on. For several views, compute their mean curvature once, here."""
        if len(shares) > 1 and self.refines:
            if self._several is None:
                self._several = self._owner.own(_Several(self._device, self._shape))
            curvatures = [(share, view.refiner.curvature) for share, view in shares if view.refiner is not None]
            self._several.take(self._curvatures.run(curvatures))

    def advance(self, *, cut: bool) -> None:
        """Prepare for a new frame; `cut` : whether the frame is unrelated to the previous frame."""
        if self.refines:
            self._start.advance(cut=cut)

    def guess(self, targets: Targets[Picture]) -> Iterate[Picture]:
        """Return the drive without steps: the mean of the views' clamp(T⁺ b) (the thesis' method) or direct mapping."""
        return standing(_Guessed(self._guesses, self._bare, clamp=True)(targets))

    def begin(self, targets: Targets[Picture]) -> Iterate[Picture]:
        """Return the start of the frame's steps."""
        return self._start.run(targets)

    def refine(self, start: Iterate[Picture], targets: Targets[Picture], steps: int) -> Iterate[Picture]:
        if len(targets) == 1:
            refiner = targets[0].view.refiner
            assert refiner is not None
            last = refiner.run(start, targets[0].b, steps)
        else:
            assert self._several is not None
            last = self._several.run(self._slopes, start, targets, steps)
        self._start.keep(last)
        return last


class _Guessed(Generic[Picture]):
    """Maps the targets of views to the mean of their drives without steps."""

    def __init__(self, mean: Mean[Picture], of: str, *, clamp: bool) -> None:
        self._mean, self._of, self._clamp = mean, of, clamp

    def __call__(self, targets: Targets[Picture]) -> Picture:
        return self._mean.run([(each.share, each.view.guess(self._of, clamp=self._clamp)(each.b)) for each in targets])


class _Several(Owning, Generic[Picture]):
    """Steps on the mean slope of several views. The slopes already contain the priors."""

    def __init__(self, device: Device[Picture], shape: tuple[int, int]) -> None:
        self._owner = Owner()
        own = self._owner.own
        prior = Ties(*(own(device.picture(picture)) for picture in vars(Prior.none(shape)).values()))
        self._step = own(device.stepper(shape, prior))
        self._inverse = own(device.canvas(shape))

    def take(self, curvature: Picture) -> None:
        self._step_size = self._inverse.draw(Inverse(curvature))

    def run(
        self, mean: Mean[Picture], start: Iterate[Picture], targets: Targets[Picture], steps: int
    ) -> Iterate[Picture]:
        p, y, made = start
        for step in range(made + 1, made + steps + 1):
            slopes = [(each.share, each.view.refiner.downhill(y, each.b)) for each in targets if each.view.refiner]
            p, y = self._step.run(step, mean.run(slopes), y, p, self._step_size)
        return Iterate(p, y, made + steps)
