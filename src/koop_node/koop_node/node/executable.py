"""Entry point of ``ros2 run koop_node container``."""

from koop_node.node.start import start


def main() -> None:
    """Start the container."""
    start("koop_node.node.container:main")
