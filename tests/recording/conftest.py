"""Lets these tests use the helpers beside them and those of the package's own tests."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "src" / "koop_bag" / "test")]
