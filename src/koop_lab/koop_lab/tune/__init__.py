"""From a recorded excitation to a controller: which cost, which constants, and what to expect."""
