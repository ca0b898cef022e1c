"""Relay and adaptive law, tuned alike, on the paper's plant and on random rigs."""
