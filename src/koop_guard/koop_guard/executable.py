"""What ``ros2 run koop_guard guard`` starts."""

from koop_node.node.start import start


def main() -> None:
    """Start the node."""
    start("koop_guard.node.guard_node:GuardNode")
