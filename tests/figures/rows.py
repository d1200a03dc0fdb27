"""All figures of pages with their commands."""

from tests.figures.prose import PROSE
from tests.figures.tables import TABLES

ROWS = (*TABLES, *PROSE)
