"""Settings: each says what it means and what it may be; the defaults are among that."""

import math
from dataclasses import fields, replace

import pytest

from koop_core.config.parameter import ConfigError, spec_of
from koop_tune.excitation.amplitude import AMPLITUDE
from koop_tune.excitation.channels import CHANNELS
from koop_tune.excitation.design import DESIGN
from koop_tune.excitation.static_map import MAP
from koop_tune.rig_model.dwells import DWELLS
from koop_tune.rig_model.fluctuation import FLUCTUATION
from koop_tune.search.settings import CONVERGENCE, SEARCH, TUNING, VERIFICATION

ALL = (AMPLITUDE, CHANNELS, DESIGN, MAP, DWELLS, FLUCTUATION, CONVERGENCE, SEARCH, TUNING,
       VERIFICATION)  # fmt: skip
FIELDS = [(settings, item) for settings in ALL for item in fields(settings)
          if "spec" in item.metadata]  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "item"), FIELDS, ids=[f"{type(s).__name__}.{f.name}" for s, f in FIELDS]
)
def test_a_setting_says_what_it_means_and_refuses_what_it_may_not_be(settings, item):
    spec, value = spec_of(item), getattr(settings, item.name)
    assert spec.description
    assert replace(settings, **{item.name: value}) == settings
    if not isinstance(value, tuple) and math.isfinite(spec.low):
        below = spec.low - 1 if isinstance(value, int) else math.nextafter(spec.low, -math.inf)
        with pytest.raises(ConfigError, match=item.name):
            replace(settings, **{item.name: below})
    with pytest.raises(ConfigError, match=item.name):
        replace(settings, **{item.name: "many"})


def test_what_a_study_has_chosen_says_so():
    origins = {spec_of(item).origin for _, item in FIELDS}
    assert {"koop study commission", "JSBSim's aircraft"} <= origins
    chosen = [item for _, item in FIELDS if spec_of(item).origin]
    assert len(chosen) > 0.6 * len(FIELDS)
