"""Studies that fill the tables of docs/: python -m tests.studies.NAME. No test depends on them."""
