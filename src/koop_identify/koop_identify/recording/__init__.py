"""Recordings as arrays."""
