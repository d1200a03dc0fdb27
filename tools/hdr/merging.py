"""Merge a bracket on disk to a radiance map in OpenEXR, and write the response that was used."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from counterlight.errors import InputError
from counterlight.files.exr import write_rgb
from counterlight.response import Response, named_response
from counterlight.tools.hdr.bracket import Bracket, open_bracket
from counterlight.tools.hdr.camera_response import SUFFIXES as RESPONSES
from counterlight.tools.hdr.camera_response import write_response
from counterlight.tools.hdr.radiance import MergeOptions, RadianceMap, merge
from counterlight.tools.hdr.raw_files import is_raw
from counterlight.tools.hdr.recovery import METHODS as RECOVERIES
from counterlight.tools.hdr.recovery import NAME_IT, recover_response
from counterlight.writing.outputs import check_file
from counterlight.writing.replacing import replacing_file


@dataclass(frozen=True)
class ResponseSource:
    """Source of the camera's response: the name of a recovery method, or a known curve as `named_response` reads it."""

    name: str

    @classmethod
    def asked(cls, name: str | None, paths: Sequence[Path]) -> "ResponseSource":
        """Returns the source for a name; None means recovery, or linear for RAW. InputError for RAW with a curve."""
        raw = next(filter(is_raw, paths), None)
        if raw is not None and name not in (None, "linear"):
            raise InputError(f"--response {name}: {raw} is camera RAW, which is linear; leave the option out")
        return cls(name or ("linear" if raw else "debevec"))

    def of(self, bracket: Bracket) -> Response:
        if self.name not in RECOVERIES:
            return named_response(self.name)
        return recover_response(bracket.samples(), bracket.times_s, self.name)

    @property
    def files(self) -> list[Path]:
        """Files that the source reads."""
        return [Path(self.name)] if self.name.endswith(RESPONSES) else []

    def __str__(self) -> str:
        return f"response recovered ({self.name})" if self.name in RECOVERIES else f"response {self.name}"


@dataclass(frozen=True)
class MergeSummary:
    """The result of merging; its text is the command's output.

    decades : log₁₀ of the ratio of the 99.9th to the 0.1th percentile of the measured light.
    """

    bracket: Bracket
    source: ResponseSource
    options: MergeOptions
    shape: tuple[int, int]
    decades: float
    saturated: float
    black: float

    def __str__(self) -> str:
        times = self.bracket.times_s
        weights = "" if self.options.method == "average" else f", {self.options.weights} weights"
        return (
            f"{self.shape[1]}x{self.shape[0]}, {len(times)} pictures of {times.min():g} to {times.max():g} s, "
            f"{self.options.method}{weights}, {self.source}, {'GPU' if self.options.gpu else 'CPU'}: "
            f"{self.decades:.1f} decades, {self.saturated:.2%} of the values saturated in every picture, "
            f"{self.black:.2%} black"
        )


def merge_bracket(
    paths: Sequence[Path],
    output: Path,
    *,
    times_s: Sequence[float] | None,
    source: ResponseSource,
    options: MergeOptions,
    save_response: Path | None = None,
) -> MergeSummary:
    """Merge pictures into `output` (R, G, B; equal for a grey camera), which appears whole or not at all.

    Raises InputError for an unusable bracket: see open_bracket, Bracket.shots, recover_response, merge.
    """
    if output.suffix.lower() != ".exr":
        raise InputError(f"{output}: a radiance map is written as OpenEXR; name it {output.stem}.exr")
    check_file(output, inputs=paths)
    if save_response is not None:
        check_file(save_response, suffixes=RESPONSES, inputs=[*paths, *source.files])
    if options.method == "average" and source.name in RECOVERIES:
        raise InputError(f"--method average: shots of one exposure do not show the camera's response; {NAME_IT}")
    with replacing_file(output) as temporary:
        bracket = open_bracket(paths, times_s, repeated=options.method == "average")
        response = source.of(bracket)
        merged = merge(bracket.shots(), response, options)
        write_rgb(temporary, np.broadcast_to(merged.radiance, (*merged.radiance.shape[:2], 3)))
    if save_response is not None:
        write_response(save_response, response)
    return _summary(merged, bracket, source, options)


def _summary(merged: RadianceMap, bracket: Bracket, source: ResponseSource, options: MergeOptions) -> MergeSummary:
    low, high = np.percentile(merged.radiance[~(merged.saturated | merged.black)], (0.1, 99.9))
    return MergeSummary(
        bracket,
        source,
        options,
        (merged.radiance.shape[0], merged.radiance.shape[1]),
        float(np.log10(high / low)),
        float(merged.saturated.mean()),
        float(merged.black.mean()),
    )
