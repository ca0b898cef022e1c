"""Koopman lifting: observables, EDMD, mode selection, model file, cost; and the lifter node."""
