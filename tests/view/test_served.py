"""``--serve``: the page beside a command that runs a loop."""

import re

import pytest

from koop_bringup.live.served import served

pytestmark = pytest.mark.ros


def test_a_command_that_goes_on_prints_where_its_page_is_now(own_domain, tmp_path, capfd):
    for _ in range(2):
        with served(0, tmp_path):
            pass
    first, second = re.findall(r"http://\S+#token=\S+", capfd.readouterr().out)
    assert first != second
    assert second in (tmp_path / "view.log").read_text()
