"""Bags are written as by the tests of koop_identify."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "src" / "koop_identify" / "test"))
