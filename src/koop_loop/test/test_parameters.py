"""The parameters of the whole loop."""

from dataclasses import fields

from koop_core.config.parameter import spec_of
from koop_loop.parameters import NODES


def test_every_parameter_of_the_loop_is_described():
    for classes in NODES.values():
        for cls in classes:
            for item in fields(cls):
                assert len(spec_of(item).description) > 10, (cls, item.name)
