"""Entry point of ``ros2 run vdp_plant plant``."""

from koop_node.node.start import start


def main() -> None:
    """Start the node."""
    start("vdp_plant.node:PlantNode")
