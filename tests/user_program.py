"""A program as a user writes it, against the public names only. mypy and pyright check it in strict mode."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import counterlight as cl


def main(folder: Path) -> float:
    room: cl.Room = cl.simulate("wall", camera=(12, 16), projector=(9, 14))
    height, width = room.projector
    T = room.transport
    p: NDArray[np.float64] = np.full((height, width, 3), 0.5)
    c: NDArray[np.float64] = T @ p
    dual: NDArray[np.float64] = T.T @ c
    green: NDArray[np.float64] = T.channel(1) @ p[..., 1]
    entries: int = T.channel(0).to_csr().nnz
    picture = cl.read_picture("frame.png", room)
    found: cl.Solution = cl.solve(room, picture, solver="box", white=0.5)
    below: float = found.below_optimum
    maps = cl.build_maps(room, damping=0.1)
    with cl.Renderer(room, maps, backend="cpu") as renderer:
        drive: NDArray[np.float64] = renderer.render(picture, refine=4)
        certificate = renderer.certificate()
        bound = certificate.decibels if certificate is not None else below
    try:
        room.write(folder / "room", maps=maps, force=True)
    except cl.InputError as error:
        print(error)
    again = cl.read_room(folder / "room")
    same = cl.read_maps(folder / "room")
    lit: NDArray[np.bool_] = again.mask
    print(cl.__version__, same.white, entries, lit.mean(), dual.shape, green.shape, drive.max())
    return bound + float(again.floodlight.max()) + float(again.ambient.max())


if __name__ == "__main__":
    print(main(Path()))
