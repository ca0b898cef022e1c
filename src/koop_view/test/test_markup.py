"""Pages of tables and figures."""

import json
import re

from koop_view.report.document import Figure, Panel, Section, Series
from koop_view.report.markup import page


def test_what_is_not_finite_is_a_gap_in_its_curve():
    curve = Series("r", [0.0, 1.0, 2.0], [float("nan"), 1.23456789, float("inf")])
    figure = Figure("cost", "", (Panel("t", "r", (curve,)),))
    made = page("Title", [], [Section("cost", "Cost", "", figures=[figure])])
    (data,) = re.findall(r'"figures">(.*?)</script>', made, re.DOTALL)
    assert json.loads(data)["cost"]["panels"][0]["series"][0]["y"] == [None, 1.2346, None]
