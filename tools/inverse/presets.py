"""Settings of the inverse by what is wished for, from a study of the shipped scenes (docs/accuracy.md)."""

from counterlight.tools.inverse.near_light import InverseOptions

PRESETS = {
    "fast": InverseOptions(inverse="none"),
    "balanced": InverseOptions(max_error=2.0),
    "best": InverseOptions(inverse="whole"),
}
