from setuptools import find_packages, setup

PACKAGE = "koop_guard"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["hypothesis", "numpy", "pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": ["guard = koop_guard.executable:main"],
        "rclpy_components": ["koop_guard::GuardNode = koop_guard.node.guard_node:GuardNode"],
    },
)
