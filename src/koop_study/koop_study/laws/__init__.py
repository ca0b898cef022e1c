"""Extremum-seeking laws beside the relay: what the field would compare it with."""
