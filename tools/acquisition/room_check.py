"""Is the room as it was calibrated? Black, white and a random picture of each projector tell (docs/drift.md).

Where inside the raster the floodlit room is another one, camera or scene moved, and nothing but a new acquisition
helps. Else the pictures say where each projector's stands now, the floodlight what is left of its light, and black what
light the room has: that is undone frame by frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property

import numpy as np
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.pipeline import encoding
from counterlight.pipeline.drift import Drift, Moved
from counterlight.raster import Region
from counterlight.tools.acquisition.camera_shift import CameraShift, camera_shift
from counterlight.tools.acquisition.photographer import Photographer
from counterlight.tools.acquisition.plan import Codes, Noise, measure_noise
from counterlight.tools.acquisition.registration import Registrar, Registration, lit, random_field
from counterlight.tools.transport.transport import Transport, luminance

REPEATS = 4  # captures of each picture
MARGIN = 8  # of the raster's side: what is nearer to its border than so large a part of it
INNER = 0.999  # gives an inner pixel no more light than a thousandth
OWN = 0.99  # share of a camera pixel's light that is one projector's
CAMERA_MOVED, CAMERA_UNSURE = 0.1, 0.1  # of the camera's pixels
EXPLAINED = 0.5  # of a change by more than a pixel, or it is no camera's movement
SURE = 5.0  # standard deviations
SAME = 0.002  # of the light: a floodlit room that changes by less is the same, wherever a bare wall seems to be
OTHERWISE, MOST_OTHERWISE = 0.1, 0.03  # brighter or darker by more than that; so much of the view may be
STILL = 0.03  # projector pixels: a picture that has moved by less has not
DIMMED = 0.01  # change of light that is none
ROOM_LIGHT, SMOOTH = 0.001, 3.0  # of the floodlight, likewise, over so many camera pixels
AGREED = 0.9  # a picture that agrees less was not found
GAIN = 0.2, 5.0  # what can still be the same lamp


@dataclass(frozen=True)
class Checked:
    """What has become of a room.

    drift : what can be undone, and is to be.  said : in words.  lost : whether the calibration no longer holds.
    """

    drift: Drift
    said: str
    lost: bool = False


def check_room(photographer: Photographer, room: Calibration, transport: Transport) -> Checked:
    """Photograph the room's black, white and random pictures, and compare them with what T says."""
    codes = [registration_codes(room, region) for region in room.regions]
    black, white = (np.full((*room.projector.shape, 3), level, np.uint8) for level in (0, 255))
    shown = [picture for picture in (black, white, *codes) for _ in range(REPEATS)]
    taken = photographer.take(shown)
    groups = [taken[start : start + REPEATS] for start in range(0, len(taken), REPEATS)]
    means = [np.mean(group, axis=0) for group in groups]
    noise = measure_noise(groups[0], groups[1])
    if not (room.mask & ~photographer.saturated).any():
        raise InputError("the floodlit room is overexposed all over; expose as for the calibration")
    looked = _Looked(room, transport, means[0], means[1], noise, ~photographer.saturated)
    lost = looked.lost()
    if lost:
        return Checked(nothing(room), lost, lost=True)
    return _undone(looked, [_found(looked, *each) for each in zip(room.regions, codes, means[2:], strict=True)])


def nothing(room: Calibration) -> Drift:
    """As calibrated."""
    return Drift(tuple(Moved.nothing() for _ in room.projectors), None, "nothing has changed", _now())


def registration_codes(room: Calibration, region: Region) -> Codes:
    """The random picture of one projector, the others black: (height, width, 3)."""
    drive = np.zeros((*room.projector.shape, 3))
    drive[region.part] = random_field((region.height, region.width))[..., None]
    return encoding.encoded_drive(drive, room.response)


class _Looked:
    """The room under black and white.

    black, white : (camera height, camera width, 3).  usable : camera pixels that were not saturated, likewise.
    """

    def __init__(
        self,
        room: Calibration,
        transport: Transport,
        black: FloatArray,
        white: FloatArray,
        noise: Noise,
        usable: BoolArray,
    ) -> None:
        self.room, self.transport, self.black, self.noise = room, transport, black, noise
        self.counts = room.mask & usable
        self.after = (white - black).reshape(-1, 3)
        self.before = transport.composition()
        self._shares = [self._inner_share(region) for region in room.regions]

    @cached_property
    def inner(self) -> BoolArray:
        """(camera pixels,): lit, and not by what is near a raster's border."""
        return np.asarray(self._bright & (sum(self._shares) > INNER))

    @cached_property
    def camera(self) -> CameraShift:
        shape = self.room.camera.shape
        before, after = (luminance(light).reshape(shape) for light in (self.before, self.after))
        counts = ndimage.binary_erosion(self.inner.reshape(shape))
        return camera_shift(before, after, counts) if counts.any() else CameraShift(0, 0, np.inf, 0, 0)

    def gain(self, number: int) -> FloatArray:
        """Of each channel's light of one projector, (3,); NaN where it lights no pixel alone."""
        own = self._bright & (self._shares[number] > OWN)
        before, after = self.before[own], self.after[own]
        return np.asarray(
            [np.median(a[b > 0] / b[b > 0]) if b.any() else np.nan for a, b in zip(after.T, before.T, strict=True)]
        )

    def lost(self) -> str:
        """Why the calibration no longer holds; nothing if it does."""
        if not self.inner.any():
            return ""
        camera, gain = self.camera, self._overall
        if not GAIN[0] < gain < GAIN[1]:
            return f"the projector's light is {gain:.0%} of what it was: it is off, or lamp or exposure is another one"
        surely = camera.far > max(CAMERA_MOVED, SURE * camera.unsure) and camera.change > SAME
        if surely and (camera.far < 1 or camera.explained > EXPLAINED):
            return f"the camera has moved by {camera.right:.2f}, {camera.down:.2f} of its pixels: put it back"
        before, after = luminance(self.before)[self.inner], luminance(self.after)[self.inner]
        sigma = luminance(self.noise.sigma(self.before))[self.inner]
        otherwise = np.abs(after - gain * before) > OTHERWISE * gain * before + SURE * sigma
        if otherwise.mean() > MOST_OTHERWISE:
            share = f"{otherwise.mean():.0%} of the floodlit room"
            return f"{share} is otherwise bright than it was: something in it, or the camera, has moved"
        return ""

    @property
    def room_light(self) -> tuple[float, float, bool]:
        """Before and now, shares of the floodlight, and whether that is another light."""
        lit, old, new = self._lit.reshape(self.room.camera.shape), self.room.ambient, self.black
        level = float(self.before[self._lit].mean())
        change = ndimage.gaussian_filter(np.where(lit[..., None], new - old, 0), (SMOOTH, SMOOTH, 0))  # noise is not
        other = float(np.sqrt(np.mean(change[lit] ** 2))) > ROOM_LIGHT * level
        return float(old[lit].mean()) / level, float(new[lit].mean()) / level, other

    @property
    def _overall(self) -> float:
        return float(np.median(luminance(self.after)[self.inner] / luminance(self.before)[self.inner]))

    @cached_property
    def _lit(self) -> BoolArray:
        return lit(luminance(self.before))

    @property
    def _bright(self) -> BoolArray:
        return np.asarray(self.counts.ravel() & self._lit)

    def _inner_share(self, region: Region) -> FloatArray:
        """(camera pixels,): of near light, what the inside of a region gives."""
        inside = np.zeros((*self.room.projector.shape, 3))
        down, right = (max(side // MARGIN, 1) for side in (region.height, region.width))
        inside[region.part][down : region.height - down, right : region.width - right] = 1
        near = self.transport.without_far
        all_, some = luminance(near.composition()), luminance(near.apply(inside.reshape(-1, 3)))
        return np.divide(some, all_, out=np.zeros_like(all_), where=all_ > 0)


def _found(looked: _Looked, region: Region, codes: Codes, seen: FloatArray) -> Registration:
    registrar = Registrar(looked.transport, region, looked.counts)
    drive = looked.room.response.to_linear(codes)[region.part]
    return registrar.find(drive, (seen - looked.black).reshape(-1, 3), looked.noise)


def _undone(looked: _Looked, found: Sequence[Registration]) -> Checked:
    room, said, pictures = looked.room, [], []
    for number, (each, device) in enumerate(zip(found, room.projectors, strict=True)):
        name = "the projector" if len(found) == 1 else f"projector {number + 1}"
        if each.agreement < AGREED:
            text = f"{name}'s picture is not where any homography puts it (agreement {each.agreement:.2f})"
            return Checked(nothing(room), text, lost=True)
        marks = each.moved.at_corners(device)
        far, still = float(np.hypot(*marks.T).max()), max(STILL, SURE * each.unsure)
        white = looked.gain(number)
        gain = np.where(np.isfinite(white), white, each.moved.gain)
        dimmed = bool(np.abs(gain - 1).max() > DIMMED)
        to_raster = each.moved.to_raster if far > still else np.eye(3)
        moved = Moved(to_raster, gain if dimmed else np.ones(3))
        try:
            moved.check(device)
        except InputError as error:
            return Checked(nothing(room), f"{name}: {error}", lost=True)
        pictures.append(moved)
        if far > still:
            right, down = marks[0]
            said.append(
                f"{name}'s picture has moved by {right:.2f}, {down:.2f} pixels (its corners by up to {far:.2f})"
            )
        if dimmed:
            said.append(f"{name}'s light is {', '.join(f'{value:.1%}' for value in gain)} of what it was")
    old, new, other = looked.room_light
    if other:
        said.append(f"the room's light is {new:.2%} of white, was {old:.2%}")
    ambient = np.clip(looked.black, 0, None).astype(np.float32) if other else None
    text = "; ".join(said) if said else "nothing has changed"
    if looked.camera.unsure > CAMERA_UNSURE:
        text += " (too little texture to tell whether the camera has moved)"
    return Checked(Drift(tuple(pictures), ambient, text, _now()), text)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
