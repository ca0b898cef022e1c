"""Lets these tests use the helpers of the package's own tests, and those beside them."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "src" / "koop_view" / "test")]
