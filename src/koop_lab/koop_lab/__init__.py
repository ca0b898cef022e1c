"""Offline closed loop, training, experiments, plots and the koop command line."""
