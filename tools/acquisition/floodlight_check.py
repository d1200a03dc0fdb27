"""Compare the floodlit room as calibrated with the floodlit room now: moved cameras, changed light, moved objects."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.drift import LEAST_SHARE
from counterlight.raster import Region
from counterlight.tools.acquisition.camera_shift import CameraShift, camera_shift
from counterlight.tools.acquisition.plan import Noise
from counterlight.tools.acquisition.registration import cauchy_weights, lit, robust_scale
from counterlight.tools.transport.transport import Transport, luminance

REPEATS = 4  # number of captures of each picture
MARGIN = 8  # pixels nearer to the raster's border than 1/MARGIN of its side count as outer pixels
INNER = 0.999  # an inner camera pixel gets at least this share of its light from inside the margin
OWN = 0.99  # least share of a camera pixel's light that must come from one projector
# in camera pixels: shift that counts as moved, and uncertainty above which the shift is unknown
CAMERA_MOVED, CAMERA_UNSURE = 0.1, 0.1
EXPLAINED = 0.5  # share of the change that a camera shift of more than a pixel must explain
SURE = 5.0  # standard deviations by which a change must exceed its uncertainty
SAME = 0.002  # share of the light; a smaller change is ignored, even if a bare wall seems to be shifted
# relative change of a pixel, and largest share of the view that may change by more than this
OTHERWISE, MOST_OTHERWISE = 0.1, 0.03
# share of the floodlight that changed room light must reach; σ of the smoothing in camera pixels
ROOM_LIGHT, SMOOTH = 0.001, 3.0
SHARED = 0.02  # share of the light that comes from beyond a raster; a smaller share is ignored
GAIN = 0.2, 5.0  # limits of a plausible gain of a lamp
ROUNDS, FINEST = 8, 1e-6  # rounds of a weighted fit; least scale of the fit as a share of the light


class Known:
    """The floodlit room as T predicts it.

    before : (camera pixels, 3). T·1.
    shares : per projector, (camera pixels,). Share of near light that comes from inside the margin of its region.
    """

    def __init__(self, room: Calibration, transport: Transport) -> None:
        self.room, self.transport = room, transport
        self.before = transport.composition()
        self.lit = lit(luminance(self.before))
        self.shares = [self._inner_share(region) for region in room.regions]

    @cached_property
    def of_projectors(self) -> list[FloatArray]:
        """T·1 of each projector alone, (camera pixels, 3)."""
        if len(self.room.regions) == 1:
            return [self.before]
        return [self.transport.apply(self._white(region.part)) for region in self.room.regions]

    def _inner_share(self, region: Region) -> FloatArray:
        down, right = (max(side // MARGIN, 1) for side in (region.height, region.width))
        inside = Region(
            region.left + right, region.top + down, max(region.width - 2 * right, 0), max(region.height - 2 * down, 0)
        )
        near = self.transport.without_far
        all_, some = luminance(near.composition()), luminance(near.apply(self._white(inside.part)))
        return np.divide(some, all_, out=np.zeros_like(all_), where=all_ > 0)

    def _white(self, part: tuple[slice, slice]) -> FloatArray:
        """Returns a drive with one part of the raster white, (projector pixels, 3)."""
        drive = np.zeros((*self.room.projector.shape, 3))
        drive[part] = 1
        return drive.reshape(-1, 3)


class Looked:
    """The room under black and white.

    black, white : (camera height, camera width, 3). Radiance.
    usable : (camera height, camera width) bool. Camera pixels that were not saturated.
    used : per camera, whether its captures are used.
    """

    def __init__(
        self,
        known: Known,
        black: FloatArray,
        white: FloatArray,
        noise: Noise,
        usable: BoolArray,
        used: tuple[bool, ...],
    ) -> None:
        self.known, self.black, self.white, self.noise, self.usable = known, black, white, noise, usable
        self.used, self.after = used, (white - black).reshape(-1, 3)
        self._of_used = np.any([known.room.pixels_of(number) for number, ask in enumerate(used) if ask], axis=0)
        self.counts: BoolArray = known.room.mask & usable & self._of_used

    def using(self, used: tuple[bool, ...], exposures: FloatArray) -> "Looked":
        """Returns the room restricted to some cameras, with each camera's light divided by its exposure.

        exposures : (cameras, 3). Exposure of each camera relative to its exposure at the calibration.
        """
        black, white = (divided(picture, self.known.room, exposures) for picture in (self.black, self.white))
        return Looked(self.known, black, white, self.noise, self.usable, used)

    @cached_property
    def inner(self) -> BoolArray:
        """(camera pixels,) bool. Lit pixels whose light does not come from near a raster's border."""
        return np.asarray(self.bright & (sum(self.known.shares) > INNER))

    @property
    def bright(self) -> BoolArray:
        return np.asarray(self.counts.ravel() & self.known.lit)

    def gain(self, number: int, within: BoolArray | None = None) -> FloatArray:
        """Returns the gain of each channel of one projector's light, (3,); NaN if the projector lights no pixel alone.

        within : (camera pixels,) bool. Restricts the pixels that are used.
        """
        own = self.bright & (self.known.shares[number] > OWN)
        own = own if within is None else own & within
        before, after = self.known.before[own], self.after[own]
        return np.asarray(
            [np.median(a[b > 0] / b[b > 0]) if b.any() else np.nan for a, b in zip(after.T, before.T, strict=True)]
        )

    @property
    def room_light(self) -> tuple[float, float, bool]:
        """The room's light before and now as shares of the floodlight, and whether it has changed."""
        room = self.known.room
        lit, old, new = self.known.lit.reshape(room.camera.shape) & self._of_used, room.ambient, self.black
        level = float(self.known.before[lit.ravel()].mean())
        change = np.where(lit[..., None], new - old, 0)
        for view in room.views:
            change[view] = ndimage.gaussian_filter(change[view], (SMOOTH, SMOOTH, 0))  # removes noise
        other = float(np.sqrt(np.mean(change[lit] ** 2))) > ROOM_LIGHT * level
        return float(old[lit].mean()) / level, float(new[lit].mean()) / level, other

    def share(self, gains: Sequence[FloatArray]) -> NDArray[np.float32] | None:
        """Returns the share of the floodlight that the calibrated rasters give; None if it is 1 everywhere.

        A picture that has moved outwards lights places beyond its raster, which T saw less or not at all. The share is
        measured only near one projector's border, and only where it exceeds the noise.

        gains : gain of each projector's light.

        Returns (camera height, camera width), float32.
        """
        known, shape = self.known, self.known.room.camera.shape
        lights = [luminance(gain * light) for gain, light in zip(gains, known.of_projectors, strict=True)]
        before, after = np.asarray(sum(lights)), luminance(self.after)
        judged = (self.usable & self._of_used).ravel() & lit(after) & (sum(known.shares) <= INNER)
        alone = judged & (np.max(lights, axis=0) >= OWN * before) & (before > 0)
        share = np.clip(before[alone] / after[alone], LEAST_SHARE, 1)
        surely = 1 - share > np.maximum(SHARED, SURE * self._unsure(alone) / after[alone])
        result = np.ones(before.size, np.float32)
        result[alone] = np.where(surely, share, 1)
        return result.reshape(shape) if (result < 1).any() else None

    def _unsure(self, pixels: BoolArray) -> FloatArray:
        """Returns the standard deviation of the floodlight's luminance in some pixels."""
        sigma = self.noise.averaged(REPEATS).sigma(self.after[pixels])
        return np.asarray(np.linalg.norm(np.array(LUMINANCE) * sigma, axis=1))

    def ambient(self) -> FloatArray:
        """Returns the room's light now; pixels of unused cameras keep the calibrated light."""
        return np.where(self._of_used[..., None], np.clip(self.black, 0, None), self.known.room.ambient)


def divided(light: FloatArray, room: Calibration, exposures: FloatArray) -> FloatArray:
    """Divide the light of each camera in the raster by its exposure; exposures is (cameras, 3)."""
    result = light.copy()
    for view, exposure in zip(room.views, exposures, strict=True):
        result[view] /= exposure
    return result


class View:
    """The part of the comparison that one camera sees; `number` counts from 0."""

    def __init__(self, looked: Looked, number: int) -> None:
        self._looked, self.number = looked, number
        room = looked.known.room
        self._view, self._alone = room.views[number], len(room.cameras) == 1
        self.here: BoolArray = room.pixels_of(number).ravel()

    @property
    def name(self) -> str:
        return "the camera" if self._alone else f"camera {self.number + 1}"

    def gone(self) -> str:
        """Returns why the camera's captures cannot be used; empty if they can."""
        if not self._inner.any():
            return "" if self._alone else f"{self.name} sees nothing that tells, or is overexposed"
        gain, camera = self._overall, self.shift
        if not GAIN[0] < gain < GAIN[1]:
            return (
                f"the projector's light is {gain:.0%} of what it was{self._seen}: it is off, or lamp or exposure is "
                "another one"
            )
        surely = camera.far > max(CAMERA_MOVED, SURE * camera.unsure) and camera.change > SAME
        if surely and (camera.far < 1 or camera.explained > EXPLAINED):
            return f"{self.name} has moved by {camera.right:.2f}, {camera.down:.2f} of its pixels: put it back"
        return ""

    def otherwise(self) -> str:
        """Returns how much of the camera's view has changed brightness; empty if little has."""
        inner, looked = self._inner, self._looked
        if not inner.any():
            return ""
        before, after = (luminance(light)[inner] for light in (self._expected, looked.after))
        sigma, gain = luminance(looked.noise.sigma(looked.known.before))[inner], float(np.median(after / before))
        share = float(np.mean(np.abs(after - gain * before) > OTHERWISE * gain * before + SURE * sigma))
        if share <= MOST_OTHERWISE:
            return ""
        return (
            f"{share:.0%} of the floodlit room{self._seen} is brighter or darker than it was: something in it, or the "
            "camera, has moved"
        )

    @cached_property
    def shift(self) -> CameraShift:
        shape = self._looked.known.room.camera.shape
        before, after = (luminance(light).reshape(shape)[self._view] for light in (self._expected, self._looked.after))
        counts = ndimage.binary_erosion(self._looked.inner.reshape(shape)[self._view])
        return camera_shift(before, after, counts) if counts.any() else CameraShift(0, 0, np.inf, 0, 0)

    @property
    def unsure(self) -> bool:
        """Whether there is too little texture to measure the camera's shift."""
        return self.shift.unsure > CAMERA_UNSURE

    @property
    def _seen(self) -> str:
        return "" if self._alone else f" as {self.name} sees it"

    @property
    def _inner(self) -> BoolArray:
        return np.asarray(self._looked.inner & self.here)

    @property
    def _overall(self) -> float:
        after, before = (luminance(light)[self._inner] for light in (self._looked.after, self._looked.known.before))
        return float(np.median(after / before))

    @cached_property
    def _expected(self) -> FloatArray:
        """The floodlight expected from the current light of each projector, (camera pixels, 3).

        For several projectors, Σ g_k T_k·1 is fitted to the captures relative to T·1, with Cauchy weights. Otherwise
        the edge that a dimmed projector draws would look like a camera shift.
        """
        known, inner = self._looked.known, self._inner
        if len(known.of_projectors) == 1 or not inner.any():
            return known.before
        before = np.stack(known.of_projectors)
        expected = np.empty(known.before.shape)
        for i in range(3):
            whole = np.maximum(known.before[inner, i], np.finfo(float).tiny)
            gains = _fitted((before[:, inner, i] / whole).T, self._looked.after[inner, i] / whole)
            expected[:, i] = gains @ before[:, :, i]
        return expected


def _fitted(A: FloatArray, b: FloatArray) -> FloatArray:
    """Solve A x = b with weights that nearly ignore outliers."""
    weights, x = np.ones_like(b), np.zeros_like(A[0])
    for _ in range(ROUNDS):
        x = np.asarray(np.linalg.lstsq(weights[:, None] * A, weights * b)[0])
        residual = b - A @ x
        weights = np.sqrt(cauchy_weights(residual, robust_scale(residual, FINEST)))
    return np.asarray(x)
