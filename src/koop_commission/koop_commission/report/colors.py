"""Colours of the page's curves: positions in its palette."""

MEASURED, INTERFERENCE, BEST, OTHER, FAINT = 0, 1, 2, 3, 7
