"""What ``ros2 run koop_view server`` starts."""

from koop_node.node.start import start


def server() -> None:
    """Start the server."""
    start("koop_view.node")
