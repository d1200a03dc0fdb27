"""Which figures of which page come from which command."""

from tests.figures.prose import PROSE
from tests.figures.tables import TABLES

ROWS = (*TABLES, *PROSE)
