"""Make a calibration from pairs, and test it on pairs that the fit did not use."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight import calibration, memory
from counterlight.arrays import BoolArray, IntArray
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.response import Response
from counterlight.tools.pairs.fitting import MOST_GAIN, Fitted, agreement, fit_pairs, held_back, longest_run, parts_of
from counterlight.tools.pairs.geometry import NO_MATCH, Pictures
from counterlight.tools.pairs.matching import matched
from counterlight.tools.pairs.model import BLOCK, HALO, REACH, SPREAD, WIDE_HALO, WINDOW, block_blur, prior
from counterlight.tools.pairs.photographs import (
    Pair,
    Size,
    black_photograph,
    check_count,
    default_response,
    each_photograph,
    each_picture,
    files_in,
    pairs_by_list,
    pairs_by_number,
    read_photograph,
    read_photographs,
    read_pictures,
    set_up_folders,
)
from counterlight.tools.transport.interval import Expected, expected_quality, fit_interval, write_interval
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Csr, Dense, FarLight, Transport, stacked
from counterlight.writing.outputs import check_apart, check_file
from counterlight.writing.replacing import replacing_file

FITS = 2  # copies of a fit's features in memory at once
WRONG = 4  # at most one pair in WRONG may be wrong
HELD = 8  # one pair in HELD is predicted by a fit of the other pairs
FAINTEST = 0.02  # share of a camera pixel's largest entry; fainter entries are dropped
CODES = 256
UNSTEADY = 0.05  # deviation of gains that is reported
WHITE = 99  # percentile of the lit pixels' light that is taken as white


@dataclass(frozen=True)
class PairsOptions:
    """How pairs are read.

    listed : list of pairs; None to match numbers, or content.
    black : photograph of the black picture; None to estimate ambient light from the pairs.
    camera_response : None for linear RAW and 16-bit files, and sRGB for 8-bit files.
    camera : size of the room's camera; None to reduce the photographs by the least integer.
    quality : PNG of a held-out capture, its prediction and the difference; None to write none.
    """

    listed: Path | None = None
    black: Path | None = None
    camera_response: Response | None = None
    camera: Size | None = None
    quality: Path | None = None


@dataclass(frozen=True)
class PairsSummary:
    """The result of an import; the text is the command's output."""

    pairs: int
    held: int
    decibels: float
    matched: str
    left_out: tuple[str, ...]
    gains: float
    unsteady: tuple[str, ...]
    expected: Expected

    def __str__(self) -> str:
        lines = [
            str(self.expected),
            f"{self.pairs} pairs matched by {self.matched}; a fit without {self.held} of them predicts their captures "
            f"to {self.decibels:.1f} dB, relative to the camera's range",
        ]
        if self.gains > UNSTEADY:
            lines.append(f"gains of captures vary by {100 * self.gains:.1f} %; lock the camera's exposure")
        lines += [
            f"{each}: gain beyond {100 * (MOST_GAIN - 1):.0f} %; lock the camera's exposure" for each in self.unsteady
        ]
        lines += [f"left out: {each}" for each in self.left_out]
        return "\n".join(lines)


def import_pairs_room(
    pictures: Path,
    photographs: Path,
    folder: Path,
    options: PairsOptions,
    *,
    name: str | None = None,
    force: bool = False,
) -> PairsSummary:
    """Fit a room to pairs and write the calibration `folder`, which appears whole or not at all.

    Raises InputError for pairs that are too few, alike, saturated, of another room, or of a camera that moved.
    """
    inputs = [pictures, photographs, *(each for each in (options.listed, options.black) if each)]
    if options.quality:
        check_file(options.quality, suffixes=[".png"], inputs=inputs)
    check_apart(folder, options.quality)
    with calibration.replacing(folder, force=force, inputs=inputs) as stage:
        black = options.black or black_photograph(pictures, photographs)
        pictures, photographs = set_up_folders(pictures, photographs) or (pictures, photographs)
        pairs, by, unmatched = find_pairs(pictures, photographs, options)
        codes = read_pictures([pair.picture for pair in pairs])
        photographed = [pair.photograph for pair in pairs] + ([black] if black else [])
        light = read_photographs(photographed, options.camera_response, options.camera)
        captures, ambient = light[: len(pairs)], light[-1] if black else None
        height, width = captures.shape[1:3]
        memory.check(
            FITS * 4 * len(prior(0)) * len(pairs) * height * width,
            f"fitting {len(pairs)} pairs at {width}x{height}",
            "give fewer pairs, or a smaller --camera",
        )
        fitted, kept, wrong = _sorted_out(codes, captures, pairs)
        left_out = unmatched + wrong
        try:
            check_count(len(kept), photographs)
        except InputError as error:
            raise InputError(f"{error}; left out: {', '.join(left_out)}") from None
        codes, captures = codes[kept], captures[kept]
        held = max(1, len(kept) // HELD)
        trial = fit_pairs(codes[:-held], captures[:-held], additive=True)
        predicted = trial.predict(codes[-held:])
        predicted = predicted * trial.border.gains(predicted, captures[-held:])[:, None, None].astype(np.float32)
        quality = decibels(predicted, captures[-held:], trial.lit)
        if wrong:
            fitted = fit_pairs(codes, captures, additive=True)
        first = pairs[0].photograph
        curve = options.camera_response or default_response(first, read_photograph(first))
        room, transport = _room(fitted, codes.shape[1:3], name or folder.name, f"{len(kept)} pairs", curve, ambient)
        predicted_by_room = _held_back_by_room(fitted, room, transport, codes, captures)
        interval = fit_interval(predicted_by_room, captures, fitted.lit)
        write_transport(transport, stage)
        write_interval(interval, stage)
        calibration.write(room, stage)
        if options.quality:
            with replacing_file(options.quality) as temporary:
                write_png(temporary, quality_picture(predicted[-1], captures[-1]))
    unsteady = tuple(pairs[n].photograph.name for n in kept[fitted.unsteady])
    spread = float(np.std(fitted.gains, axis=0).max())
    white = max(float(np.percentile(captures[:, fitted.lit], WHITE)), 1e-6)
    expected = expected_quality(interval, predicted_by_room, captures, fitted.lit, white)
    return PairsSummary(len(kept), held, quality, by, tuple(left_out), spread, unsteady, expected)


def find_pairs(pictures: Path, photographs: Path, options: PairsOptions) -> tuple[list[Pair], str, list[str]]:
    """Return the pairs, how they were matched, and a line for each photograph without a picture."""
    if options.listed:
        pairs = pairs_by_list(options.listed, pictures, photographs)
        check_count(len(pairs), options.listed)
        return pairs, "a list", []
    shown, seen = files_in(pictures), files_in(photographs)
    check_count(min(len(shown), len(seen)), photographs if len(seen) <= len(shown) else pictures)
    pairs, by = matched_files(shown, seen, options.camera_response)
    if not pairs:
        raise InputError(f"{photographs}: {NO_MATCH}")
    known = {pair.photograph for pair in pairs}
    check_count(len(pairs), photographs)
    return pairs, by, [f"{path.name}, which shows no picture" for path in seen if path not in known]


def matched_files(shown: Sequence[Path], seen: Sequence[Path], response: Response | None) -> tuple[list[Pair], str]:
    """Match photographs to pictures by number, or by content where the content contradicts the numbers.

    Returns the pairs, none if no geometry is found, and how they were matched.
    """
    by_number = pairs_by_number(shown, seen)
    if by_number:
        found = _by_content([pair.picture for pair in by_number], seen, response, numbered=True)
        if found is None or ((found >= 0) & (found != np.arange(len(seen)))).sum() <= len(seen) // WRONG:
            return by_number, "number"
    found = _by_content(shown, seen, response)
    if found is None:
        return by_number or [], "number"
    return [Pair(shown[n], path) for n, path in zip(found, seen, strict=True) if n >= 0], "content"


def _by_content(
    shown: Sequence[Path], seen: Sequence[Path], response: Response | None, *, numbered: bool = False
) -> IntArray | None:
    pictures = (each / np.float32(255) for each in each_picture(shown))
    captures = (each ** (1 / 2.2) for each in each_photograph(seen, response))
    return matched(pictures, captures, numbered=numbered)


def _sorted_out(
    codes: NDArray[np.uint8], captures: Pictures, pairs: list[Pair]
) -> tuple[Fitted, NDArray[np.intp], list[str]]:
    """Return a fit of all pairs, the numbers of those that belong to the room, and a line for each other pair."""
    fitted = fit_pairs(codes, captures, additive=True)
    found = agreement(fitted.predict(codes), captures, fitted.lit)
    if longest_run(list(found.moved)) > 1 or found.moved.sum() > len(pairs) // HELD:
        first = int(np.flatnonzero(found.moved)[0])
        raise InputError(
            f"{pairs[first].photograph}: shifted by {found.shift[first]:.1f} camera pixels against the "
            "other photographs; the camera moved in between. Photograph all pictures again from one place"
        )
    wrong = found.foreign | found.moved
    if wrong.sum() > len(pairs) // WRONG:
        raise InputError(f"{wrong.sum()} of {len(pairs)} pairs do not belong to the room; {NO_MATCH}")
    lines = [
        f"{pairs[n].photograph.name}: shifted by {found.shift[n]:.1f} camera pixels"
        if found.moved[n]
        else f"{pairs[n].name}, which do not belong together"
        for n in np.flatnonzero(wrong)
    ]
    return fitted, np.flatnonzero(~wrong), lines


def decibels(predicted: Pictures, captures: Pictures, lit: BoolArray) -> float:
    """Return the PSNR in linear light, relative to the camera's range, of lit pixels."""
    error = float(np.mean((np.clip(predicted, 0, 1) - captures)[:, lit] ** 2))
    return float(-10 * np.log10(max(error, 1e-12)))


def _held_back_by_room(
    fitted: Fitted, room: Calibration, transport: Transport, codes: NDArray[np.uint8], captures: Pictures
) -> Pictures:
    """Predict each capture by a model fitted to others, plus the difference of T p + e from the model fitted to all."""
    predicted = held_back(fitted, parts_of(fitted, codes, captures, additive=True), codes)
    for number, (picture, model) in enumerate(zip(codes, fitted.predict(codes), strict=True)):
        light = transport @ room.response.to_linear(picture).reshape(-1, 3)
        predicted[number] += light.reshape(model.shape) + room.ambient - model
    return predicted


def quality_picture(predicted: NDArray[np.floating], capture: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return a capture, its prediction and their difference (grey: none, tenfold) next to each other."""
    white = max(float(np.percentile(capture, 99.5)), 1e-6)
    both = [np.clip(each / white, 0, 1) ** (1 / 2.2) for each in (capture, predicted)]
    row = np.concatenate([*both, np.clip(0.5 + 10 * (predicted - capture) / white, 0, 1)], axis=1)
    return np.asarray(np.rint(row * 255), np.uint8)


def _room(
    fitted: Fitted,
    projector: tuple[int, int],
    name: str,
    what: str,
    camera: Response,
    black: NDArray[np.floating] | None,
) -> tuple[Calibration, Transport]:
    transport = transport_of(fitted, projector)
    ambient = ambient_of(fitted) if black is None else black
    curve = fitted.processing.light(np.repeat(np.linspace(0, 1, CODES)[:, None], 3, axis=1)).astype(np.float64)
    response = Response("table", table=tuple(tuple(float(v) for v in row) for row in curve / curve[-1]))
    room = Calibration(
        name,
        f"counterlight import-pairs: {what}, response from the pairs",
        (Device(*projector, response),),
        Device(ambient.shape[0], ambient.shape[1], camera),
        ambient,
        fitted.lit,
    )
    return room, transport


def ambient_of(fitted: Fitted) -> NDArray[np.floating]:
    """Return the light at black, (height, width, 3)."""
    model = fitted.model
    planes = [_coefficient(fitted, k, 0) for k in range(3)]
    return np.asarray(np.maximum(model.offset + np.stack(planes, axis=-1), 0), np.float32)


def _coefficient(fitted: Fitted, k: int, feature: int) -> NDArray[np.floating]:
    shape = fitted.model.slope.shape[:2]
    planes = [level.plane(k, feature, shape) for level in fitted.model.levels]
    return np.asarray(np.sum(planes, axis=0), np.float32)


def transport_of(fitted: Fitted, projector: tuple[int, int]) -> Transport:
    """Return T of a fit of an additive response."""
    camera = fitted.model.slope.shape[:2]
    seen = [_interpolation(fitted.places.places[k], projector, fitted.factor) for k in range(3)]
    near = [_pruned(sparse.csr_array(_taps(fitted, k) @ seen[k])) for k in range(3)]
    return Transport.from_matrices(near, _far(fitted, seen), camera=camera, projector=projector)


def _interpolation(places: NDArray[np.floating], projector: tuple[int, int], factor: int) -> Csr:
    """Return the matrix that samples a projector picture at places given in its reduced version; dark outside."""
    height, width = (-(-side // factor) for side in projector)
    x, y = (places[..., axis].ravel().astype(np.float64) for axis in range(2))
    rows, columns, weights = [], [], []
    for dy in range(2):
        for dx in range(2):
            at_y, at_x = np.floor(y).astype(int) + dy, np.floor(x).astype(int) + dx
            weight = (1 - np.abs(y - at_y)) * (1 - np.abs(x - at_x))
            there = (at_y >= 0) & (at_y < height) & (at_x >= 0) & (at_x < width) & (weight > 0)
            rows.append(np.flatnonzero(there))
            columns.append((at_y * width + at_x)[there])
            weights.append(weight[there])
    lookup = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(sparse.csr_array(lookup, (x.size, height * width)) @ _means(projector, factor))


def _means(projector: tuple[int, int], factor: int) -> Csr:
    """Return the matrix that reduces a projector picture, with its border repeated."""
    lines = []
    for side in projector:
        small = -(-side // factor)
        at = np.minimum(np.arange(small * factor), side - 1)
        entries = (np.full(small * factor, 1 / factor), (np.arange(small * factor) // factor, at))
        lines.append(sparse.csr_array(entries, (small, side)))
    return sparse.csr_array(sparse.kron(lines[0], lines[1], format="csr"))


def _taps(fitted: Fitted, k: int) -> Csr:
    """Return the spread of camera pixels over their neighbours in radiance, (camera pixels, camera pixels)."""
    slope = fitted.model.slope[..., k]
    height, width = slope.shape
    y, x = np.mgrid[:height, :width]
    taps = [_coefficient(fitted, k, SPREAD + n) for n in range(len(WINDOW))]
    centre = 1 + _coefficient(fitted, k, 1) - np.sum(taps, axis=0)
    weights, columns = [slope * centre], [y * width + x]
    for (dy, dx), tap in zip(WINDOW, taps, strict=True):
        weights.append(slope * tap)
        at_y, at_x = np.clip(y + dy - REACH, 0, height - 1), np.clip(x + dx - REACH, 0, width - 1)
        columns.append(at_y * width + at_x)
    rows = np.tile(np.arange(height * width), len(weights))
    entries = (
        np.concatenate([w.ravel() for w in weights]).astype(np.float64),
        (rows, np.concatenate([c.ravel() for c in columns])),
    )
    return sparse.csr_array(entries, (height * width,) * 2)


def _pruned(T: Csr) -> Csr:
    """Drop negative and faint entries, and scale each row to its sum."""
    T.sum_duplicates()
    rows = np.repeat(np.arange(T.shape[0]), np.diff(T.indptr))
    wanted = np.maximum(np.asarray(T.sum(axis=1)).ravel(), 0)
    largest = np.zeros(T.shape[0])
    np.maximum.at(largest, rows, T.data)
    T.data[T.data < FAINTEST * largest[rows]] = 0
    T.eliminate_zeros()
    kept = np.asarray(T.sum(axis=1)).ravel()
    scale = np.divide(wanted, kept, out=np.zeros_like(kept), where=kept > 0)
    return _float32(sparse.diags_array(scale) @ T)


def _far(fitted: Fitted, seen: list[Csr]) -> FarLight | None:
    """Return the halo as far light over blocks of camera pixels; None if there is none."""
    shape = fitted.model.slope.shape[:2]
    blocks = (-(-shape[0] // BLOCK), -(-shape[1] // BLOCK))
    count, pixels = blocks[0] * blocks[1], shape[0] * shape[1]
    y, x = np.mgrid[: shape[0], : shape[1]]
    block = (y // BLOCK * blocks[1] + x // BLOCK).ravel()
    gather, mix = [], np.zeros((3, count, count))
    for k in range(3):
        light = (fitted.model.slope[..., k].ravel() / BLOCK**2, (block, np.arange(pixels)))
        gather.append(_float32(sparse.csr_array(light, (count, pixels)) @ seen[k]))
        for number, sigma in enumerate(HALO[1:], WIDE_HALO):
            padding = ((0, -shape[0] % BLOCK), (0, -shape[1] % BLOCK))
            padded = np.pad(_coefficient(fitted, k, number), padding, mode="edge")
            strength = cv2.resize(padded, blocks[::-1], interpolation=cv2.INTER_AREA)
            blur = np.kron(block_blur(blocks[0], sigma), block_blur(blocks[1], sigma))
            mix[k] += strength.reshape(-1, 1) * blur
    mix = np.maximum(mix, 0)
    if not mix.any():
        return None
    between = [_interpolation_of_blocks(shape, blocks)] * 3
    return FarLight(stacked(gather), Dense(mix), stacked(between))


def _interpolation_of_blocks(shape: tuple[int, int], blocks: tuple[int, int]) -> Csr:
    """Return the matrix that interpolates between the middles of blocks, (camera pixels, blocks)."""
    lines = []
    for side, count in zip(shape, blocks, strict=True):
        at = np.clip((np.arange(side) + 0.5) / BLOCK - 0.5, 0, count - 1)
        lines.append(sparse.csr_array(np.maximum(0, 1 - np.abs(at[:, None] - np.arange(count)))))
    return _float32(sparse.kron(lines[0], lines[1], format="csr"))


def _float32(matrix: Csr) -> Csr:
    return sparse.csr_array(matrix).astype(np.float32)
