"""Entry point of ``ros2 run relay_esc esc``."""

from koop_node.node.start import start


def main() -> None:
    """Start the node."""
    start("relay_esc.node:EscNode")
