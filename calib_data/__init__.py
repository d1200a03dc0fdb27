"""What is shipped to try things on: scenes/*.toml, and media/ with its licence in README.md."""
