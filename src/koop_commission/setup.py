from setuptools import find_packages, setup

PACKAGE = "koop_commission"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    extras_require={"test": ["pytest"]},
    entry_points={
        "koop.commands": [
            "check = koop_commission.stages.check:register",
            "commission = koop_commission.command:register",
            "excite = koop_commission.stages.excite:register",
            "tune = koop_commission.stages.tune:register",
            "verify = koop_commission.stages.verify:register",
        ]
    },
)
