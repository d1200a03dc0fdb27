"""Evaluate folders of real pairs: `python -m tests.real FOLDER`."""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from counterlight.arrays import BoolArray
from counterlight.command import parse_size, run
from counterlight.errors import InputError
from counterlight.tools.pairs.fitting import Fitted, Part, fit_pairs, held_back, parts_of
from counterlight.tools.pairs.geometry import Pictures
from counterlight.tools.pairs.photographs import LEAST
from counterlight.tools.transport.interval import NOMINAL, coverage, fit_interval
from tests.real.correction import fit_correction
from tests.real.folders import HELD, DataSet, read_data_set
from tests.real.measures import measured, psnr, srgb
from tests.real.surrogate import SIZE, fit_surrogate, reduced_codes

DIRECTIONS = ["forward", "interval", "surrogate"]
HEADER = "| | PSNR | RMSE | SSIM | ΔE2000 |\n|---|---|---|---|---|"


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    size = options.size[::-1] if options.size else None
    train, test = read_data_set(options.folder, options.pictures, options.photographs, size)
    if test is None:
        train, test = _split(train, options.train, options.test)
    if len(train.names) < LEAST or not test.names:
        raise InputError(
            f"{options.folder}: {len(train.names)} training pairs and {len(test.names)} held out, expected at least "
            f"{LEAST} and 1; change --train and --test"
        )
    print(f"{len(train.names)} training pairs, {len(test.names)} held out: {', '.join(test.names)}", flush=True)
    start = time.monotonic()
    fitted = fit_pairs(train.pictures, train.captures, additive=options.additive)
    parts = list(parts_of(fitted, train.pictures, train.captures, additive=options.additive))
    if "forward" in options.directions:
        _forward(fitted, parts, train, test)
    if "interval" in options.directions:
        _interval(fitted, parts, train, test)
    if "surrogate" in options.directions:
        _surrogate(fitted, parts, train, test)
    print(f"{time.monotonic() - start:.0f} s")


def _split(pairs: DataSet, train: int | None, test: int | None) -> tuple[DataSet, DataSet]:
    held = test or max(1, len(pairs.names) // HELD)
    last = max(0, len(pairs.names) - held) if train is None else train
    return _some(pairs, slice(0, last)), _some(pairs, slice(last, last + held))


def _some(pairs: DataSet, chosen: slice) -> DataSet:
    return replace(pairs, pictures=pairs.pictures[chosen], captures=pairs.captures[chosen], names=pairs.names[chosen])


def _forward(fitted: Fitted, parts: list[Part], train: DataSet, test: DataSet) -> None:
    shown, lit = fitted.shown(test.pictures), fitted.lit
    for levels in range(len(fitted.model.levels)):
        _print_forward(f"{levels} levels", fitted.model.predict(shown, levels), test, lit)
    predicted = fitted.model.predict(shown)
    correction = fit_correction(fitted, parts, train.pictures, train.captures)
    border = fitted.border.gains(predicted, test.captures)[:, None, None]
    corrected = correction.predict(test.pictures, predicted)
    for name, each in (("model", predicted), ("corrected", corrected)):
        _print_forward(name, each, test, lit)
        _print_forward(f"{name}, gains from the border", each * border, test, lit)
        gains = (each * test.captures)[:, lit].sum(axis=1) / (each**2)[:, lit].sum(axis=1)
        fitted_gains = f"{name}, gains fitted to the judged captures ({np.abs(gains - 1).max():.3f} at most)"
        _print_forward(fitted_gains, each * gains[:, None, None], test, lit)
    print(HEADER)
    for name, each in (("model", predicted), ("corrected", corrected)):
        found = measured(srgb(each * border), srgb(test.captures), lit)
        print(f"| forward, {name}, code values | {found} |", flush=True)


def _print_forward(name: str, predicted: Pictures, test: DataSet, lit: BoolArray) -> None:
    linear = psnr(predicted, test.captures, lit)
    codes = psnr(srgb(predicted), srgb(test.captures), lit)
    print(f"forward, {name}: {linear:.2f} dB linear, {codes:.2f} dB code values", flush=True)


def _interval(fitted: Fitted, parts: list[Part], train: DataSet, test: DataSet) -> None:
    """Print the share of captured values inside the interval, and its width; then both for one constant width."""
    lit, border = fitted.lit, fitted.border
    held = held_back(fitted, parts, train.pictures)
    predicted = fitted.predict(test.pictures)
    held *= border.gains(held, train.captures)[:, None, None].astype(np.float32)
    predicted *= border.gains(predicted, test.captures)[:, None, None].astype(np.float32)
    interval = fit_interval(held, train.captures, lit)
    widths = np.stack([interval.half_width(each) for each in predicted])
    constant = np.full_like(widths, np.quantile(np.abs(held - train.captures)[:, lit], NOMINAL))
    print(f"{100 * NOMINAL:.0f} % interval: inside per capture, and of dark, middle and bright pixels; mean width")
    for name, half in (("interval", widths), ("one width", constant)):
        found = coverage(half, predicted, test.captures, lit)
        least, most = (100 * end(found.captures) for end in (np.min, np.max))
        print(
            f"{name}: {100 * found.share:.1f} % inside ({least:.0f} to {most:.0f} per capture); {found.parts}; "
            f"width {found.width:.4f}",
            flush=True,
        )


def _surrogate(fitted: Fitted, parts: list[Part], train: DataSet, test: DataSet) -> None:
    surrogate = fit_surrogate(fitted, parts, train.pictures, train.captures)
    found = surrogate.pictures(test.captures)
    true = reduced_codes(test.pictures)
    everywhere = np.ones((SIZE[1], SIZE[0]), bool)
    print(f"{HEADER}\n| per-pixel inverse | {measured(surrogate.start(test.captures), true, everywhere)} |")
    print(f"| surrogate | {measured(found, true, everywhere)} |", flush=True)


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"a number of pairs is at least 0, found {text!r}")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.real", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the data set")
    parser.add_argument(
        "--pictures",
        metavar="NAME",
        help="folder of the pictures below it (default: prj/share/train or ../train)",
    )
    parser.add_argument(
        "--photographs", metavar="NAME", help="folder of the captures below it (default: cam/raw/train)"
    )
    parser.add_argument("--train", type=_count, help="number of training pairs (default: all but the held-out pairs)")
    parser.add_argument(
        "--test", type=_count, help="number of held-out pairs after the training pairs (default: an eighth)"
    )
    parser.add_argument("--size", type=parse_size, metavar="WxH", help="size of the captures (default: half)")
    parser.add_argument(
        "--additive", action="store_true", help="fit only the parts of the model that a calibration can hold (no φ)"
    )
    parser.add_argument("--directions", nargs="+", choices=DIRECTIONS, default=DIRECTIONS)
    return parser


if __name__ == "__main__":
    sys.exit(main())
