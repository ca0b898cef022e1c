"""What the tests of commissioning share: the rig, its file, and commands."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "view"))
sys.path.insert(0, str(Path(__file__).parent))

from commission_rig import RIG, FastRig

from koop_tune.rig import rig_file


@pytest.fixture
def fast_rig(own_domain):
    """Run the rig."""
    rig = FastRig()
    yield rig
    rig.close()


@pytest.fixture
def rig_yaml(tmp_path):
    """Write its rig file."""
    path = tmp_path / "rig.yaml"
    rig_file.write(RIG, path)
    return path


@pytest.fixture
def koop(tmp_path):
    """Start a command; it is waited for, and what it said is shown if the test fails."""
    running = []

    def start(*words):
        process = subprocess.Popen(
            [sys.executable, "-m", "koop_lab", *map(str, words)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        )  # fmt: skip
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        print(*process.args, *process.communicate(), sep="\n")
