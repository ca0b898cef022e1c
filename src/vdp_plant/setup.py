from setuptools import find_packages, setup

PACKAGE = "vdp_plant"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest", "scipy"]},
    entry_points={
        "console_scripts": ["plant = vdp_plant.executable:main"],
        "rclpy_components": ["vdp_plant::PlantNode = vdp_plant.node:PlantNode"],
    },
)
