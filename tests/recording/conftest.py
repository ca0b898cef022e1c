"""Lets these tests use the helpers of the package's own tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "src" / "koop_bag" / "test"))
