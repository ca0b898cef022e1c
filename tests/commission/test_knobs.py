"""A rig with two knobs, from its rig file to the verdict."""

import signal

import numpy as np
import pytest
from commission_rig import PAPER, PLANT, PaperRig
from test_excite import RESUMED
from waiting import wait

from koop_tune.excitation import progress
from koop_tune.rig import rig_file
from koop_tune.search.rounds import load_verification

pytestmark = pytest.mark.ros
TIMEOUT = 300.0


@pytest.fixture
def paper_rig(own_domain):
    rig = PaperRig()
    yield rig
    rig.close()


def amplitude(theta):
    """Return the amplitude of the paper's limit cycle over the best one."""
    coupling = np.array(PLANT.coupling).reshape(2, 2)
    return np.hypot(1.0, np.linalg.norm(coupling @ (theta - np.array(PLANT.theta_star))))


def test_two_coupled_knobs_are_commissioned_from_rig_file_to_verdict(paper_rig, koop, tmp_path):
    rig_file.write(PAPER, tmp_path / "rig.yaml")
    for stage in ("check", "excite --out run", "tune run --effort 0.02", "verify run"):
        for _ in range(RESUMED):
            process = koop(stage.split()[0], "rig.yaml", *stage.split()[1:])
            out, error = process.communicate(timeout=TIMEOUT)
            if "to resume: " not in error:  # a busy machine lets the rig be silent for too long
                break
        assert process.returncode == 0 or stage == "verify run", out + error
    is_damped = "The rig is damped" in out
    assert process.returncode == (0 if is_damped else 1), out + error
    assert paper_rig.theta.tolist() == list(PAPER.theta_safe)
    state = progress.load(PAPER, tmp_path / "run")
    held = [amplitude(hold.theta) for hold in state.holds]
    levels = np.exp([hold.level for hold in state.holds])
    best = int(np.argmin(levels))
    assert held[best] < 1.1
    near = np.array(held) < 3.0
    assert (levels / levels[best])[near] == pytest.approx(
        np.array(held)[near] / held[best], rel=0.2
    )
    (last,) = load_verification(tmp_path / "run").rounds
    starts = [run.start for run in last.runs]
    assert sum(starts[0]) == pytest.approx(0.5)  # the opposite corner, as near as the line lets it
    assert 0.5 - 1e-9 < paper_rig.most <= 0.5
    corners = [amplitude((a, b)) for a in (-4.9, -1.5) for b in (-0.6, 2.4)]
    assert amplitude(starts[1]) == pytest.approx(max(corners))
    ends = [amplitude(run.measured.theta) for run in last.runs]
    assert min(ends) < 1.3
    assert not is_damped or max(ends) < 1.5  # the verdict holds; not every law comes as near
    paper_rig.most, safe = -np.inf, np.array(PAPER.theta_safe)
    process = koop("up", "run", "--out", "months")
    wait(lambda: np.abs(paper_rig.theta - safe).max() > 0.5, "the loop to move theta", process)
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0, out + error
    assert paper_rig.theta.tolist() == safe.tolist()
    assert -np.inf < paper_rig.most <= 0.5  # the line is kept at every sample
