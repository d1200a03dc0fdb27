"""DejaVu Sans 2.37, under its own free licence (the file LICENSE in this folder)."""
