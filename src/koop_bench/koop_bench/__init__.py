"""Measurements of this machine, as ratios to a baseline of the same run."""
