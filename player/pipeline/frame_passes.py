"""The passes of a frame in their order, from code values to code values: the plan that renderer.py carries out.

`python -m counterlight.pipeline.frame_passes` prints the list of docs/architecture.md. tests/test_architecture.py
compares `passes_of_frame` with traces of frames. Names are modules of counterlight.passes, or the maps of
passes/product.py. The text after a name completes a sentence.
"""

FramePasses = tuple[tuple[str, str], ...]  # (name of a pass, what the pass does)

TARGET: FramePasses = (
    ("planes_to_linear", "decodes code values to linear light"),
    ("resample", "fits the picture to the camera's view, in width"),
    ("resample", "fits the picture to the camera's view, in height (`player/pipeline/placed.py`)"),
    ("desired", "computes the target b = c − e, limited to what the room can show (`player/pipeline/request.py`)"),
)
UNDO_FAR: FramePasses = (
    (
        "map undo_gather",
        "gathers b into *nodes*, the samples of far light (`player/pipeline/room_view.py`)",
    ),
    ("map undo_mix", "predicts the compensated picture's far light between nodes"),
    ("map far_scatter", "spreads the predicted far light over camera pixels, and subtracts it from b"),
)
INVERSE: FramePasses = (("map correction", "multiplies b by T⁺, the correction map of thesis chapter 5"),)
START: FramePasses = (
    (
        "combine",
        "adds to T⁺ b what refinement changed in the last frame, and clamps the sum p (`player/pipeline/starts.py`)",
    ),
    ("combine", "adds the previous frame's momentum to p, which gives the drive y"),
)
RESIDUAL: FramePasses = (
    ("map transport", "begins a step with b − S y, the residual of near light (`player/pipeline/refiner.py`)"),
)
FAR_RESIDUAL: FramePasses = (
    ("map far_gather", "gathers the drive y into nodes of far light"),
    ("map far_mix", "computes the far light of y between nodes"),
    ("map far_scatter", "subtracts the far light of the drive y, which gives the residual b − T y"),
)
SLOPE: FramePasses = (("map dual", "computes the part of the slope TᵀW (b − T y) from near light"),)
FAR_SLOPE: FramePasses = (
    ("map dual_gather", "gathers the residual into nodes of far light"),
    ("map dual_mix", "multiplies the gathered residual by the transpose of `far_mix`"),
    ("map dual_scatter", "adds the part of the slope from far light"),
)
STEP: FramePasses = (("refinement_step", "makes a projected gradient step, with Nesterov's momentum"),)
KEEP: FramePasses = (
    ("combine", "keeps what refinement changed, p − T⁺ b, for the next frame"),
    ("combine", "keeps the momentum y − p for the next frame"),
)
SEND: FramePasses = (
    ("encode", "applies the inverse response of each projector, dithers, and writes 8-bit code values"),
)


def passes_of_frame(*, steps: int, far: bool) -> FramePasses:
    """Return the passes of a compensated frame in the projector's view, for a room of one view.

    steps : steps of refinement; 0 gives clamp(T⁺ b).
    far : whether the room has far light.
    """
    start = (*TARGET, *(UNDO_FAR if far else ()), *INVERSE)
    step = (*RESIDUAL, *FAR_RESIDUAL, *SLOPE, *FAR_SLOPE, *STEP) if far else (*RESIDUAL, *SLOPE, *STEP)
    return (*start, *START, *steps * step, *KEEP, *SEND) if steps else (*start, *SEND)


def listed() -> str:
    """Return the numbered list of the passes in a room with far light, with one step of refinement."""
    passes = enumerate(passes_of_frame(steps=1, far=True), 1)
    return "\n".join(f"{number}. `{name}` {does}." for number, (name, does) in passes)


if __name__ == "__main__":
    print(listed())
