"""What the controller would have said to recorded states: state, r and theta over time."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # a file is written: no display is needed or looked for
from matplotlib import pyplot as plt

from koop_identify.recording.signals import Signals
from koop_lab.plots.paper import envelope, fit, save
from koop_lab.replay.open_loop import Answers


def plot_open_loop(path: Path, signals: Signals, answers: Answers, title: str) -> None:
    """Draw states, r and theta; the ending of the file chooses the format."""
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(10, 7), layout="constrained")
    figure.suptitle(title)
    for name, values in zip(signals.names, signals.x.T, strict=True):
        envelope(axes[0], signals.t, values, name)
    axes[0].set_ylabel("measured state")
    axes[0].legend(loc="upper right", ncols=4)
    envelope(axes[1], signals.t, answers.r, "r")
    fit(axes[1], answers.r)
    axes[1].set_ylabel("r under the model")
    envelope(axes[2], signals.t, answers.theta, "would have said (open loop)")
    if signals.has_theta:
        envelope(axes[2], signals.t, signals.theta, "recorded")
    axes[2].legend(loc="upper right")
    axes[2].set_ylabel("theta")
    axes[2].set_xlabel("time [s]")
    save(figure, axes, path)
