"""The parameters of the whole loop."""

from dataclasses import fields

import pytest

from koop_core.config.parameter import ConfigError, spec_of
from koop_loop.parameters import NODES, build


def test_every_parameter_of_the_loop_is_described():
    for classes in NODES.values():
        for cls in classes:
            for item in fields(cls):
                assert len(spec_of(item).description) > 10, (cls, item.name)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("duration", "a parameter of vdp_plant$"),
        ("dt", "a parameter of vdp_plant, koopman_lifter$"),
        ("dwel", r"did you mean 'dwell'\?$"),
    ],
)
def test_a_parameter_of_another_node_is_refused_with_that_node_named(name, reason):
    """Failed before: 'duration' of relay_esc was taken for a misspelt 'step_ratio'."""
    with pytest.raises(ConfigError, match=f"^relay_esc: unknown parameter '{name}': {reason}"):
        build({"relay_esc": {name: 1.0}})
