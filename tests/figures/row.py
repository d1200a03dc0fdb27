"""A row: figures of a page and the commands that give them."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.figures.cells import Reader, markdown


@dataclass(frozen=True)
class Figures:
    """page : below the repository.  commands : as the page or a user says them, run one after the other.

    stated, found : read the page, and what the commands wrote: what they printed and `files`, below where they ran.
    minutes : on two cores, about.  times : whether a cell of a name is one.  units, share : see cells.py.
    head : of a table, how its header begins.
    """

    page: str
    commands: tuple[str, ...]
    minutes: float
    stated: Reader
    found: Reader
    files: tuple[str, ...] = ()
    times: Callable[[str], bool] = field(default=lambda name: False)
    units: float = 2.0
    share: float = 0.05
    head: str = ""

    @property
    def name(self) -> str:
        return f"{self.page}: {'; '.join(self.commands)}"


def table(
    page: str, command: str, minutes: float, beginning: str, times: tuple[str, ...] = (), **told: object
) -> Figures:
    """A table that a command prints, or writes into a file, as the page has it.  times : columns."""
    reader = markdown(beginning)
    is_time = ending(*(f", {column}" for column in times))
    return Figures(page, (command,), minutes, reader, reader, times=is_time, head=beginning, **told)  # type: ignore[arg-type]


def ending(*ends: str) -> Callable[[str], bool]:
    return lambda name: name.endswith(ends) if ends else False
