from setuptools import find_packages, setup

PACKAGE = "koop_bag"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={
        "test": ["hypothesis", "mcap-ros2-support", "pytest", "rosbags"],
        "store": ["fsspec", "universal-pathlib", "s3fs"],
    },
    entry_points={
        "console_scripts": [
            "recorder = koop_bag.executable:recorder",
            "player = koop_bag.executable:player",
        ],
        "koop.commands": ["bag = koop_bag.cli:register"],
        "rclpy_components": [
            "koop_bag::RecorderNode = koop_bag.recorder.node:RecorderNode",
            "koop_bag::PlayerNode = koop_bag.player.node:PlayerNode",
        ],
    },
)
