"""python -m counterlight: the command with its verbs, wherever its script is not on the path."""

import sys

from counterlight.tools.verbs import main

sys.exit(main())
