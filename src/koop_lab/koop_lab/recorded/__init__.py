"""Recorded runs: as arrays, as metrics, as a page."""
