"""Entry points of ``ros2 run koop_bag recorder`` and ``ros2 run koop_bag player``."""

from koop_node.node.start import start


def recorder() -> None:
    """Start the recorder."""
    start("koop_bag.recorder.node:RecorderNode")


def player() -> None:
    """Start the player."""
    start("koop_bag.player.node:PlayerNode")
