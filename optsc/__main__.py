"""``python -m optsc``."""

import sys

from optsc.cli import main

sys.exit(main())
