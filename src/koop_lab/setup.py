from setuptools import find_packages, setup

PACKAGE = "koop_lab"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={
        "koop_lab.cli": ["commands.txt"],
        "koop_lab.page": ["page.js", "page.css", "vendor/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
    ],
    install_requires=[
        "koop_bag",
        "koop_bringup",
        "koop_loop",
        "koop_node",
        "koopman_lifter",
        "relay_esc",
        "vdp_plant",
        "matplotlib",
        "mcap",
        "mcap-ros2-support",
        "numpy",
        "scipy",
        "tqdm",
    ],
    extras_require={"test": ["PyYAML", "hypothesis", "pytest", "rosbags"]},
    zip_safe=False,
    maintainer="koop maintainers",
    maintainer_email="maintainers@koop.invalid",
    description="The koop commands: demo, train, replay, plots, benchmarks.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["koop = koop_lab.cli.main:main"],
        "koop.commands": [
            "bag = koop_lab.recorded.command:register",
            "bench = koop_lab.bench.command:register",
            "check = koop_lab.commission.check:register",
            "commission = koop_lab.commission.command:register",
            "demo = koop_lab.live.demo:register",
            "excite = koop_lab.commission.excite:register",
            "fleet = koop_lab.live.fleet_command:register",
            "inspect = koop_lab.identify.command:register",
            "params = koop_lab.cli.params:register",
            "replay = koop_lab.replay.command:register",
            "simulate = koop_lab.cli.simulate:register",
            "train = koop_lab.identify.command:register",
            "tune = koop_lab.tune.command:register",
            "up = koop_lab.live.up:register",
            "verify = koop_lab.commission.verify:register",
        ],
    },
)
