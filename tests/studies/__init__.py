"""Studies that fill the tables of docs/: python -m tests.studies.NAME. Nothing here decides a test."""
