"""The passes of a frame on either backend: planes -> linear picture -> placed in the camera's view -> b -> drive -> 8
bit (thesis 5.2).

The choice of view, drive and certificate is written once for every device (device.py). Device objects are made when a
room or medium is opened, or on first use (a view, an adjustment). OpenGL compiles most passes on their first draw. All
other frames allocate nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.frames import Frame, PixelFormat
from counterlight.passes.drawing import Canvas, Picture
from counterlight.passes.shown_maps import Split
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.content import SceneCuts
from counterlight.pipeline.correction import CorrectedDrive, Correction
from counterlight.pipeline.damper import Damper
from counterlight.pipeline.device import Device, Owner, Owning, Planes
from counterlight.pipeline.placed import Crossfade, Placed
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.refiner import Goal, Refiner
from counterlight.pipeline.room import Room
from counterlight.pipeline.room_view import RoomView, Target
from counterlight.pipeline.shortfall import Snapshot
from counterlight.pipeline.shown_copies import ShownCopies, SmallPicture
from counterlight.pipeline.stage_times import StageTimes
from counterlight.pipeline.starts import Iterate, standing
from counterlight.pipeline.view_blend import ViewBlend
from counterlight.pipeline.views import VIEWS
from counterlight.response import Response
from counterlight.viewpoints import Viewpoint


class Renderer(Owning, Generic[Picture]):
    """Renders frames: `open`, then `upload` and `render` any number of times, then read results; `release` at the end.

    path : how this renderer multiplies with the maps, for reports.

    No part refers back to the renderer. A reload therefore frees the replaced room at once, without waiting for garbage
    collection.
    """

    def __init__(self, device: Device[Picture], room: Room) -> None:
        self._device, self._room = device, room
        self._owner = Owner()
        self._owner.own(device)
        self._adjustments = NEUTRAL
        self._medium: _Medium[Picture] | None = None
        self._prepared: _Medium[Picture] | None = None
        self._leaving: _Leaving[Picture] | None = None
        self._view = ""  # the view rendered last; empty since a medium was opened
        self._damper: Damper[Picture] | None = None
        self._copies: ShownCopies[Picture] | None = None
        self._times = StageTimes(device.finish)
        with self._owner:
            self._build()

    def _build(self) -> None:
        device, room, own = self._device, self._room, self._owner.own
        calibration = room.calibration
        camera, projector = calibration.camera.shape, calibration.projector.shape
        self._room_views = [own(RoomView(device, each)) for each in room.views]
        self.path = self._room_views[0].stored.report
        self._blend = own(ViewBlend(device, self._room_views, projector))
        self._blend.start_from(room.start)
        self._stand(NEUTRAL.viewpoint)
        drift = room.drift
        self._moved: CorrectedDrive[Picture] | None = None
        if drift is not None and drift.moves:
            self._moved = own(CorrectedDrive(device, room, drift.projectors))
        self._projector_view = own(device.encoder(projector, calibration.response, 1.0, room.dither))
        self._camera_view = own(device.encoder(camera, Response("srgb").over(camera), room.white, "none"))

    @cached_property
    def _split(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._room.calibration.camera.shape))

    @cached_property
    def _small_projector(self) -> SmallPicture[Picture]:
        return self._owner.own(SmallPicture(self._device, self._room.calibration.projector.shape, 1.0))

    @cached_property
    def _small_camera(self) -> SmallPicture[Picture]:
        return self._owner.own(SmallPicture(self._device, self._room.calibration.camera.shape, self._room.white))

    def start_from(self, start: str, bare: str = "map") -> None:
        """Set where refinement starts, one of STARTS, from the next render on.

        bare : drive of a picture without steps: "map" for T⁺ b, or "direct" for direct mapping.
        """
        self._blend.start_from(start, bare)

    def prepare(self, pixels: PixelFormat, *, crossfade: bool = False) -> None:
        """Build the resources of `open` while the previous medium still plays; raises InputError as `open` does."""
        here = None if crossfade else self._medium
        if any(made is not None and made.pixels == pixels for made in (here, self._prepared)):
            return
        check_radiance(pixels, self._room)
        self._owner.give_up(self._prepared)
        self._prepared = self._owner.own(_Medium(self._device, self._room_views, pixels))

    def open(self, pixels: PixelFormat, *, crossfade: bool = False) -> None:
        """Accept frames of this format from now on; raises InputError if they do not suit the room.

        crossfade : keep the previous medium, which fades out (`fade`), until `end_crossfade`.
        """
        self.end_crossfade()
        crossfade = crossfade and self._medium is not None
        self.prepare(pixels, crossfade=crossfade)
        if self._prepared is not None and self._prepared.pixels == pixels:
            before, self._medium, self._prepared = self._medium, self._prepared, None
            if crossfade and before is not None:
                self._leaving = self._owner.own(_Leaving(self._device, self._medium, before))
            else:
                self._owner.give_up(before)
        assert self._medium is not None
        self._medium.planes.adjust(self._adjustments)
        shown: Sequence[Placed[Picture] | Crossfade[Picture]] = (
            self._medium.placed if self._leaving is None else self._leaving.crossfades
        )
        for room_view, placed in zip(self._room_views, shown, strict=True):
            room_view.request.open(placed, self._adjustments)
        self._cuts = SceneCuts()
        self._view = ""

    def fade(self, level: float, weight: float = 0.0) -> None:
        """Scale the light from the next render on: 0 is black, 1 is full.

        weight : share of the previous medium in a crossfade.
        """
        for room_view in self._room_views:
            room_view.request.fade(level)
        if self._leaving is not None:
            for crossfade in self._leaving.crossfades:
                crossfade.set(weight)

    def correct(self, correction: Correction) -> None:
        """Correct for a changed room from the next render on. Later calls allocate nothing.

        The correction's ambient light and row gains apply to the first view.
        """
        if self._moved is None:
            self._moved = self._owner.own(CorrectedDrive(self._device, self._room, correction.projectors))
        self._moved.set(correction.projectors)
        self._room_views[0].ambient.add(correction.ambient, correction.paint)
        self._room_views[0].row_gains.set(correction.row_gains)
        for room_view in self._room_views:
            room_view.request.scale_white(correction.white)

    def end_crossfade(self) -> None:
        """Release the previous medium."""
        leaving, self._leaving = self._leaving, None
        if leaving is None or self._medium is None:
            return
        for room_view, placed in zip(self._room_views, self._medium.placed, strict=True):
            room_view.request.take(placed)
        self._owner.give_up(leaving)
        self._owner.give_up(leaving.medium)

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply the viewer's settings from the next render on; they persist when another medium is opened.

        Pictures for an adaptation, a card, corners or a damper are made here, on first use. OpenGL compiles a pass that
        it has not drawn yet in the next frame.
        """
        previous = self._adjustments
        if adjustments.viewpoint != previous.viewpoint:
            self._stand(adjustments.viewpoint)
        self._adjustments = adjustments
        if self._medium is not None and adjustments != replace(previous, viewpoint=adjustments.viewpoint):
            self._medium.planes.adjust(adjustments)
            if self._leaving is not None:
                self._leaving.medium.planes.adjust(adjustments)
            for room_view in self._room_views:
                room_view.request.adjust(adjustments)
        if adjustments.flicker and self._damper is None:
            self._damper = self._owner.own(Damper(self._device, self._room.calibration.projector.shape))
        if self._damper is not None and not previous.flicker:
            self._damper.restart()

    def upload_before(self, frame: Frame) -> None:
        """Take a frame of the medium that fades out."""
        if self._leaving is not None:
            self._leaving.medium.planes.upload(frame.planes)

    def upload(self, frame: Frame) -> None:
        """Take a frame's planes; the caller may release the frame afterwards."""
        self._planes.upload(frame.planes)
        cut = self._cuts.starts_with(frame) and self._leaving is None
        for room_view in self._room_views:
            room_view.request.advance(cut=cut, duration_s=frame.duration_s)
        self._blend.advance(cut=cut)
        if self._damper is not None:
            self._damper.advance(cut=cut)

    @property
    def _planes(self) -> Planes[Picture]:
        """Planes of the open medium."""
        assert self._medium is not None
        return self._medium.planes

    def _stand(self, viewpoint: Viewpoint) -> None:
        """Choose the views with a share in the drive. `_main_view`, the view with the largest share, is shown.

        Raises InputError for a place in a room with one view.
        """
        shares = [
            (float(share), room_view)
            for share, room_view in zip(self._room.shares(viewpoint), self._room_views, strict=True)
        ]
        self._shares = [(share, room_view) for share, room_view in shares if share > 0]
        self._main_view = max(self._shares, key=lambda each: each[0])[1]
        self._blend.stand(self._shares)

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0, timed: bool = False) -> None:
        """Compute a view of the uploaded frame, one of VIEWS.

        view : split shows the camera's view without | with compensation. error shows the distance from the target.
            impossible shows targets that no picture can reach (views.py). For a test card, error shows the camera's
            view.
        steps : steps of refinement, if the room has its maps; 0 is clamp(T⁺ b), the thesis' method.
        timed : wait after each stage, and report times in `stage_s`.
        """
        if view not in VIEWS or steps < 0:
            raise ValueError(f"view {view!r}, {steps} steps: expected one of {', '.join(VIEWS)}, and no steps below 0")
        self._times.begin(timed=timed)
        self._decoded = self._run_planes()
        self._times.end("linear")
        self._compensated: _Compensated[Picture] | None = None
        self._sent: Picture | None = None
        self._linear = self._shown(view, compensate=compensate and self._adjustments.card is None, steps=steps)
        self._times.end("view")
        encoder = self._projector_view if view == "projector" else self._camera_view
        self._encoded, self._view = encoder.run(self._linear, frame), view
        self._times.end("encode")

    @property
    def stage_s(self) -> Mapping[str, float]:
        """Seconds per stage (stage_times.STAGES) of the frame that was timed last."""
        return self._times.seconds

    def encoded(self) -> NDArray[np.uint8]:
        """Return the view as 8-bit code values: by projector response, or sRGB with white = 1 for the camera."""
        return self._device.read(self._encoded, np.uint8)

    def linear(self) -> NDArray[np.float32]:
        """Return the rendered view in linear light: drive 0..1, or the camera picture in screen primaries."""
        return self._device.read(self._linear, np.float32)

    def desired(self) -> NDArray[np.float32]:
        """Return the adapted and placed target: (camera height, camera width, 3), in screen primaries."""
        return self._main_view.request.desired(self._run_planes())

    def _run_planes(self) -> Picture:
        """Return the decoded picture. During a crossfade, decode the picture of the previous medium, too."""
        if self._leaving is not None:
            self._leaving.decode()
        return self._planes.run()

    def small(self) -> NDArray[np.uint8] | None:
        """Return the rendered view as a small sRGB picture; None before the first frame of a medium.

        Reads every pixel of the view once.
        """
        if not self._view:
            return None
        made = self._small_projector if self._view == "projector" else self._small_camera
        return self._device.read(made.run(self._linear), np.uint8)

    def small_seen(self) -> NDArray[np.uint8] | None:
        """Return the predicted camera picture of the rendered drive, as a small sRGB picture; None without a drive.

        Costs a product with T, unless the camera view is shown.
        """
        if self._view == "camera":
            return self.small()
        if not self._view or self._sent is None:
            return None
        return self._device.read(self._small_camera.run(self._main_view.observers[0].run(self._sent)), np.uint8)

    def copy_shown(self, factor: int, grid: tuple[int, int]) -> ShownCopies[Picture]:
        """Draw small copies of the rendered drive (ShownCopies). The copies stay until the next call."""
        if self._copies is None:
            regions = self._room.calibration.regions
            self._copies = self._owner.own(ShownCopies(self._device, regions, factor, grid))
        self._copies.take(self._linear)
        return self._copies

    def finish(self) -> None:
        """Wait until the device has computed everything."""
        self._device.finish()

    def certificate(self) -> Certificate | None:
        """Return how far the rendered drive can be from the best drive. None without compensation, without the maps of
        refinement, or between views, where no optimum is defined.

        Costs as much as a step of refinement.
        """
        if self._compensated is None or (refiner := self._compensated.refiner) is None:
            return None
        last, targets, _ = self._compensated
        return refiner.certify(last.p, self._goal(targets[0].b))

    def snapshot(self) -> Snapshot | None:
        """Return the certificate with the pictures for an estimate (survey.py), which are read back from the device."""
        if self._compensated is None or (refiner := self._compensated.refiner) is None:
            return None
        last, targets, steps = self._compensated
        return refiner.snapshot(last, self._goal(targets[0].b), steps)

    def _shown(self, view: str, *, compensate: bool, steps: int) -> Picture:
        if view == "impossible":
            return self._main_view.views.impossible()
        if view == "projector":
            return self._shown_to_projector(compensate=compensate, steps=steps)
        if self._adjustments.card is not None:
            return self._seen(self._plain())
        targets = self._targets()
        if view == "split":
            drives = self._plain(), self._drive(targets, steps)
            self._sent = drives[1]
            plain, corrected = (
                observe.run(drive) for observe, drive in zip(self._main_view.observers, drives, strict=True)
            )
            seen = self._split.draw(Split(plain, corrected, self._room.white))
        else:
            seen = self._seen(self._drive(targets, steps) if compensate else self._plain())
        if view == "error":
            wanted = self._main_view.request.unbounded(self._decoded, weighed=False)
            seen = self._main_view.views.error(seen, wanted)
        if self._adjustments.clipping:
            seen = self._main_view.views.over_camera(seen, self._main_view.near_light(self._unbounded()))
        return seen

    def _seen(self, drive: Picture) -> Picture:
        self._sent = drive
        return self._main_view.observers[0].run(drive)

    def _shown_to_projector(self, *, compensate: bool, steps: int) -> Picture:
        if not compensate:
            self._sent = self._plain()
            return self._sent
        drive = self._sent = self._drive(self._targets(), steps)
        if self._adjustments.clipping:
            wanted = self._main_view.guess("map", clamp=False)(self._unbounded())
            drive = self._main_view.views.over_projector(drive, wanted)
        return drive if self._moved is None else self._moved.run(drive)

    def _goal(self, b: Picture) -> Goal[Picture]:
        return Goal(b, self._unbounded(), self._plain())

    def _plain(self) -> Picture:
        return self._main_view.request.plain(self._decoded)

    def _unbounded(self) -> Picture:
        return self._main_view.request.unbounded(self._decoded)

    def _targets(self) -> list[Target[Picture]]:
        targets = [
            Target(share, room_view, room_view.request.light(self._decoded)) for share, room_view in self._shares
        ]
        self._times.end("place")
        return targets

    def _drive(self, targets: list[Target[Picture]], steps: int) -> Picture:
        refined = self._blend.refines and steps > 0
        last = self._blend.begin(targets) if refined else self._blend.guess(targets)
        self._times.end("start")
        if refined:
            last = self._blend.refine(last, targets, steps)
            self._times.end("steps")
        if self._damper is not None and self._adjustments.flicker:
            last = standing(self._damper.run(last.p, self._adjustments.flicker))
        self._compensated = _Compensated(last, targets, steps)
        return last.p


AnyRenderer: TypeAlias = Renderer[Any]  # for callers that do not handle the backend's pictures


class _Compensated(NamedTuple, Generic[Picture]):
    """The drive of the rendered view, its targets, and its steps of refinement."""

    last: Iterate[Picture]
    targets: list[Target[Picture]]
    steps: int

    @property
    def refiner(self) -> Refiner[Picture] | None:
        """The certificate's view: None between views."""
        return self.targets[0].view.refiner if len(self.targets) == 1 else None


class _Medium(Owning, Generic[Picture]):
    """The passes of a format: planes -> linear picture, and its placement in each view."""

    def __init__(self, device: Device[Picture], room_views: Sequence[RoomView[Picture]], pixels: PixelFormat) -> None:
        self.pixels, self._owner = pixels, Owner()
        with self._owner:
            self.planes = self._owner.own(device.planes(pixels))
            self.placed = [self._owner.own(room_view.request.make(pixels)) for room_view in room_views]


class _Leaving(Owning, Generic[Picture]):
    """A medium that fades out while another fades in. `crossfades` has one entry per view."""

    def __init__(self, device: Device[Picture], now: "_Medium[Picture]", before: "_Medium[Picture]") -> None:
        self.medium, self._owner = before, Owner()
        with self._owner:
            self.crossfades = [
                self._owner.own(Crossfade(device, *pair)) for pair in zip(now.placed, before.placed, strict=True)
            ]

    def decode(self) -> None:
        before = self.medium.planes.run()
        for crossfade in self.crossfades:
            crossfade.take(before)


def check_radiance(pixels: PixelFormat, room: Room) -> None:
    """Raise InputError unless an OpenEXR picture, which is camera radiance, has the size of the only camera."""
    camera = room.calibration.camera
    if pixels.layout == "radiance" and room.others:
        raise InputError(
            f"an OpenEXR picture is the radiance of one view, the room has {len(room.others) + 1}; play one of them, "
            "or save it as PNG"
        )
    if pixels.layout == "radiance" and (pixels.height, pixels.width) != camera.shape:
        raise InputError(
            f"an OpenEXR picture of {pixels.width}x{pixels.height} pixels, the camera has "
            f"{camera.width}x{camera.height}: it is taken as radiance pixel by pixel, so resize it or save it as PNG"
        )
