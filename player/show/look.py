"""The property `lut`: the colour table of a show, read again when the show reloads."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from counterlight.errors import InputError
from counterlight.files.cube import Cube, read_cube
from counterlight.pipeline.value_types import Anything
from counterlight.show.lookup import LookUp
from counterlight.show.registry import CommandError, Property
from counterlight.show.session import Session

READ_S = 1.0  # longest time that the show waits for a disk


def look_properties(session: Session) -> dict[str, Property]:
    def name() -> str:
        cube = session.adjustments.lut
        return "no" if cube is None else str(cube.path)

    def put(name: object) -> None:
        if not isinstance(name, str):
            raise CommandError(f"lut: expected the name of a .cube file or no, found {name!r}")
        cube = None if name in ("", "no") else _read(partial(session.programme.opener.cube, name))
        session.adjust(replace(session.adjustments, lut=cube))

    text = "colour table for the media, a .cube file"
    return {"lut": Property(text, name, put, Anything("no, a path"))}


def read_again(cube: Cube) -> Cube:
    """Read the table's file again. Raises InputError if the file is damaged."""
    return _read(partial(read_cube, cube.path))


def _read(read: Callable[[], Cube]) -> Cube:
    found = LookUp(read).result(READ_S)
    if found is None:
        raise InputError(f"lut: not read within {READ_S:g} s; copy it to a local disk")
    return found
