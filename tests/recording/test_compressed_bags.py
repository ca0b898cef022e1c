"""Bags that rosbag2 compressed, given to every command that reads bags.

The format is told in `src/koop_bag/test/koop_bag_compressed.py`, which makes them.
"""

from pathlib import Path

import pytest
from koop_bag_compressed import compress

from koop_lab.cli.main import main
from koopman_lifter.model import load

GOLDEN = Path(__file__).parents[2] / "recordings" / "golden" / "run"
TRAIN = ["--measured", "/state:x", "--modes", "4"]


@pytest.fixture(scope="module", params=["MESSAGE", "FILE"])
def packed(request, tmp_path_factory):
    """Return the golden bag as rosbag2 would have compressed it."""
    folder = tmp_path_factory.mktemp("packed")
    return compress(GOLDEN / "bag", folder / "bag", request.param)


def koop(capsys, *words):
    code = main([*map(str, words)])
    return code, "".join(capsys.readouterr())


def test_info_and_metrics_say_what_they_say_of_the_plain_bag(packed, capsys):
    for words in (["info"], ["metrics"]):
        code, said = koop(capsys, "bag", *words, packed)
        expected = koop(capsys, "bag", *words, GOLDEN / "bag")
        assert code == 0
        # all but the lines on the bag's own path and size
        lines = [[line for line in text.splitlines() if "bag" not in line and " B" not in line]
                 for text in (said, expected[1])]  # fmt: skip
        assert lines[0] == lines[1]


def test_replay_is_equal_bit_for_bit(packed, capsys):
    model = GOLDEN / "model" / "vdp.npz"
    code, said = koop(capsys, "replay", packed, "--offline", "--model", model)
    assert code == 0, said
    assert "theta  identical bit for bit in all 2000 steps" in said


def test_training_gives_the_same_model(packed, tmp_path, capsys):
    models = []
    for bag in (packed, GOLDEN / "bag"):
        out = tmp_path / f"{len(models)}.npz"
        code, said = koop(capsys, "train", bag, *TRAIN, "--out", out)
        assert code == 0, said
        models.append(load(out).K)
    assert (models[0] == models[1]).all()


def test_diff_export_and_recover(packed, tmp_path, capsys):
    code, said = koop(capsys, "bag", "diff", packed, GOLDEN)
    assert code == 0, said
    assert (
        koop(capsys, "bag", "export", packed, "--topic", "/theta", "-o", tmp_path / "out")[0] == 0
    )
    assert len((tmp_path / "out" / "theta.csv").read_text().splitlines()) == 2001
    code, said = koop(capsys, "bag", "recover", packed, tmp_path / "saved")
    assert code == 0, said
    assert koop(capsys, "bag", "diff", tmp_path / "saved", GOLDEN)[0] == 0
