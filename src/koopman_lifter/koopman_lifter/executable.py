"""Entry point of ``ros2 run koopman_lifter lifter``."""

from koop_node.node.start import start


def main() -> None:
    """Start the node."""
    start("koopman_lifter.node:LifterNode")
