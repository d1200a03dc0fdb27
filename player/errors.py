"""The one exception that a user is meant to read."""


class InputError(Exception):
    """Wrong use or bad input: one line that says what, where, expected and found, and what to do.

    A command prints it as `error: …` and ends with exit code 2 (`player.command`).
    """
