"""Relay extremum-seeking control: pure kernel and node."""
