"""The page: HTML, CSS and a script, which loads nothing from elsewhere and speaks as link.py and visitor.py do."""
