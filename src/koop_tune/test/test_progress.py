"""What an interrupted excitation knows."""

from test_knobs_design import KNOBS

from koop_tune.excitation import progress
from koop_tune.excitation.progress import ExcitationProgress, HoldSummary


def test_a_hold_that_became_too_short_stays_known_until_theta_was_there_again(tmp_path):
    """Failed before: a resumed excitation went over the whole range once more."""
    short, kept = HoldSummary((1.0, 5.0), 0.0, 0.1, 2.0, 17.0), HoldSummary((2.0, 5.0), *4 * [1.0])
    state = ExcitationProgress()
    state.set_holds(KNOBS, [short, kept])
    assert (state.holds, state.aside) == ([short, kept], [])
    state.set_holds(KNOBS, [kept])
    assert (state.holds, state.aside) == ([kept], [short])
    progress.save(state, KNOBS, tmp_path)
    resumed = progress.load(KNOBS, tmp_path)
    assert resumed.done == [kept, short]
    longer = short._replace(seconds=60.0)
    resumed.set_holds(KNOBS, [kept, longer])
    assert resumed.done == [kept, longer]
    twice = [*resumed.done, longer]
    resumed.set_holds(KNOBS, twice)
    resumed.set_holds(KNOBS, [longer])
    assert (resumed.holds, resumed.aside) == ([longer], [kept, longer])
