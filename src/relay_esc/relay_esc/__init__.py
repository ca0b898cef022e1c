"""Relay extremum-seeking control: pure kernel and a thin node."""
