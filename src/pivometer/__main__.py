"""``python -m pivometer``, for where the command is not on the path."""

import sys

from pivometer.cli import main

sys.exit(main())
