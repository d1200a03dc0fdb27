"""Benchmarks of all parts, compared with other libraries in the same run: make bench. No test depends on them."""
