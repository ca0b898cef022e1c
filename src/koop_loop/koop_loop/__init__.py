"""The closed loop as a pure function: kernel, parameters, metrics, static map, training."""
