"""A row: figures of a page and the commands that print them."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.figures.cells import Reader, markdown


@dataclass(frozen=True)
class Figures:
    """Figures of a page and their commands.

    page : below the repository.
    commands : as on the page or as a user types them, run in sequence.
    stated, found : readers of the page, and of the commands' output.
    files : written by the commands below their folder, and read after their output.
    minutes : on two cores, approximately.
    times : whether a cell name is a time.
    units, share : see cells.py.
    head : beginning of a table's header.
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
    """Returns the row for a table that a command prints, or writes into a file, as on the page.

    times : columns with times.
    """
    reader = markdown(beginning)
    is_time = ending(*(f", {column}" for column in times))
    return Figures(page, (command,), minutes, reader, reader, times=is_time, head=beginning, **told)  # type: ignore[arg-type]


def ending(*ends: str) -> Callable[[str], bool]:
    return lambda name: name.endswith(ends) if ends else False
