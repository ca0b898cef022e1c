"""``python -m koop_lab`` is ``koop``."""

import sys

from koop_lab.cli import main

if __name__ == "__main__":
    sys.exit(main())
