"""Spectra: a projector's primaries, pigments, a camera's sensitivities, and the resulting mixing.

Camera channel k sees primary l on a pigment of reflectance ρ as M_kl = Σ_λ C_k(λ) ρ(λ) P_l(λ), over 24 bands of
12.5 nm. Cameras, pigments and observers are data of colour-science. The camera is balanced so that a perfect white
under full drive is 1 in each channel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import colour
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BANDS, SHORTEST_NM, WIDTH_NM = 24, 400.0, 12.5
CENTRES_NM = SHORTEST_NM + WIDTH_NM * (np.arange(BANDS) + 0.5)
CHART, CAMERA = "ColorChecker N Ohta", "Nikon 5100 (NPL)"
OBSERVER = "CIE 1931 2 Degree Standard Observer"
# A wall's paints: names of the chart, in the order of a pigment map's last axis.
PIGMENTS = ("white 9.5 (.05 D)", "neutral 5 (.70 D)", "black 2 (1.5 D)", "moderate red", "blue sky", "orange yellow")
PAPER, GREY, INK, RED, BLUE, YELLOW = range(len(PIGMENTS))
MIXED_BANDS = 17, 10, 4  # bands of one-band primaries: 619, 531 and 456 nm


@dataclass(frozen=True)
class Light:
    """A projector's light and the camera that sees it.

    primaries : (3, bands). Spectral power at full drive.
    sensitivities : (3, bands), balanced.
    weakness : (3,), ≥ 1. Gain of each channel relative to the strongest channel, before balance.
    """

    name: str
    primaries: FloatArray
    sensitivities: FloatArray
    weakness: FloatArray

    def mixing(self, reflectances: FloatArray) -> FloatArray:
        """Returns M of each pigment: (pigments, bands) -> (pigments, camera channel, primary)."""
        return np.einsum("kb,qb,lb->qkl", self.sensitivities, reflectances, self.primaries)

    def seen(self, illuminant: FloatArray, reflectances: FloatArray) -> FloatArray:
        """Returns what the camera sees of pigments under an illuminant (bands,): (pigments, 3); white's mean is 1."""
        white = self.sensitivities @ illuminant
        return np.einsum("kb,qb,b->qk", self.sensitivities, reflectances, illuminant) / white.mean()

    def of_white(self) -> FloatArray:
        """Returns M of a perfect white screen, (3, 3), channel by primary. Rows sum to 1."""
        return np.asarray(self.sensitivities @ self.primaries.T)

    def to_xyz(self) -> FloatArray:
        """Returns (3, 3) from this camera's RGB to CIE XYZ with Y = 1 for white, by least squares over a chart.

        Every combination of full primaries lights each patch, so that the projector's own colours are fitted too.
        """
        observer = spectra(colour.MSDS_CMFS[OBSERVER])
        drives = np.array([[number >> bit & 1 for bit in range(3)] for number in range(1, 8)])
        stimuli = (drives @ self.primaries)[:, None] * chart()
        xyz = stimuli @ observer.T / (observer[1] @ self.primaries.sum(axis=0))
        rgb = stimuli @ self.sensitivities.T
        return np.asarray(np.linalg.lstsq(rgb.reshape(-1, 3), xyz.reshape(-1, 3), rcond=None)[0].T)


def separate() -> Light:
    """Returns a light without crosstalk: each channel of the camera sees one primary."""
    return mixed(0.0)


def mixed(share: float) -> Light:
    """Returns a light where `share` of each camera channel's white comes equally from the neighbouring primaries.

    The primaries have one band each, so leaked light keeps the reflectance at its own wavelength: T_kl = X_kl ρ(λ_l).
    """
    near = np.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
    primaries, sensitivities = np.zeros((3, BANDS)), np.zeros((3, BANDS))
    primaries[range(3), MIXED_BANDS] = 1
    sensitivities[:, MIXED_BANDS] = (1 - share) * np.eye(3) + share * near
    return Light(f"{share:.0%} crosstalk", primaries, sensitivities, np.ones(3))


def led() -> Light:
    """Returns three LEDs: narrow bands, half widths 20, 35 and 25 nm."""
    return _photographed("LED", np.stack([_bell(625, 20), _bell(525, 35), _bell(460, 25)]))


def wheel() -> Light:
    """Returns a white lamp, mercury lines on a continuum, behind a colour wheel with overlapping filters."""
    lines = spectra(colour.SDS_ILLUMINANTS["FL11"])
    lamp = 0.75 + 0.25 * lines / lines.mean()
    filters = _edge(585, 8), _edge(492, 8) - _edge(604, 8), 1 - _edge(508, 8)
    return _photographed("colour wheel", np.stack([lamp * each for each in filters]))


LIGHTS: dict[str, Callable[[], Light]] = {
    "separate": separate,
    "12 %": lambda: mixed(0.12),
    "led": led,
    "wheel": wheel,
}


@cache
def pigments() -> FloatArray:
    """Returns reflectance, (pigments, bands)."""
    return np.stack([spectra(colour.SDS_COLOURCHECKERS[CHART][name]) for name in PIGMENTS])


@cache
def chart() -> FloatArray:
    """Returns reflectance of the whole chart, (24, bands)."""
    return np.stack([spectra(patch) for patch in colour.SDS_COLOURCHECKERS[CHART].values()])


@cache
def room_light() -> FloatArray:
    """Returns daylight through a curtain, (bands,): CIE D50."""
    return spectra(colour.SDS_ILLUMINANTS["D50"])


def spectra(tabulated: object) -> FloatArray:
    """Returns means over the bands of one or more colour-science spectra: (bands,) or (functions, bands)."""
    nm, values = np.asarray(tabulated.wavelengths), np.asarray(tabulated.values)  # type: ignore[attr-defined]
    fine = (SHORTEST_NM + np.arange(BANDS * WIDTH_NM * 2) / 2 + 0.25).clip(nm[0], nm[-1])
    columns = values.reshape(nm.size, -1).T
    means = [np.interp(fine, nm, column).reshape(BANDS, -1).mean(axis=1) for column in columns]
    return np.squeeze(np.array(means)) if values.ndim == 1 else np.array(means)


def _photographed(name: str, primaries: FloatArray) -> Light:
    raw = spectra(colour.MSDS_CAMERA_SENSITIVITIES[CAMERA])
    white = raw @ primaries.sum(axis=0)
    return Light(name, primaries, raw / white[:, None], white.max() / white)


def _bell(centre_nm: float, width_nm: float) -> FloatArray:
    """Returns a Gaussian of unit power with a given full width at half maximum."""
    shape = np.exp(-4 * np.log(2) * ((CENTRES_NM - centre_nm) / width_nm) ** 2)
    return np.asarray(shape / shape.sum())


def _edge(nm: float, width_nm: float) -> FloatArray:
    """Returns a filter that passes longer wavelengths."""
    return np.asarray(1 / (1 + np.exp(-(CENTRES_NM - nm) / width_nm)))
