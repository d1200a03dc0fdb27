"""The page: HTML, CSS and a script. It loads nothing from other hosts, and uses the protocol of visitor.py."""
