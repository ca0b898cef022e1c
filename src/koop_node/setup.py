from setuptools import find_packages, setup

PACKAGE = "koop_node"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={PACKAGE: ["*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["container = koop_node.node.executable:main"]},
)
