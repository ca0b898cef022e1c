"""Koopman lifting: observables, EDMD, mode selection, model file, cost; and a thin node."""
