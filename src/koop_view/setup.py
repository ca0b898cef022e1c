from setuptools import find_packages, setup

PACKAGE = "koop_view"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"koop_view": ["page/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["hypothesis", "pytest"]},
    maintainer="koop maintainers",
    maintainer_email="maintainers@koop.invalid",
    description="The page that shows and operates a loop, the Foxglove protocol, "
    "and the pages of reports.",
    license="Apache-2.0",
    entry_points={
        "koop.commands": ["serve = koop_view.command:register"],
    },
)
