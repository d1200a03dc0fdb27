"""Settings of the inverse by what is wished for, found by counterlight study on the shipped scenes (docs/accuracy.md)."""

from counterlight.tools.inverse.inverse import InverseOptions

PRESETS = {
    "fast": InverseOptions(max_cluster=200),
    "balanced": InverseOptions(max_error=2.0),
    "best": InverseOptions(),
}
