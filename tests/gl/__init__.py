"""The GPU against its CPU twin."""
