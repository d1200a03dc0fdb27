"""python -m counterlight: the command with its verbs, for systems where its script is not on the path."""

import sys

from counterlight.tools.verbs import main

sys.exit(main())
