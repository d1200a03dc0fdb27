"""DejaVu Sans 2.37, under its own free licence (LICENSE beside it)."""
