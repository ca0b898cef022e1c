"""What ``koop check`` prints and asks on a terminal."""

import io
import os
import pty
import re
import sys

from tqdm import tqdm

from koop_commission.fitness.fitness import BAD, OK, Finding
from koop_commission.stages.check import ask_yes, print_findings


class Terminal(io.StringIO):
    """A terminal that is looked at afterwards."""

    def isatty(self):
        return True


def test_findings_are_not_printed_into_the_line_of_the_progress(monkeypatch):
    """Failed before: a finding began where the progress ended."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    with tqdm(total=2.0, disable=None) as bar:
        bar.refresh()
        assert print_findings([Finding(OK, "command", "none"), Finding(BAD, "theta", "dead")]) == 1
    for line in ("ok    command     none", "BAD   theta       dead"):
        assert re.search(rf"\r *\r{line}\n", terminal.getvalue())


def test_the_rig_is_looked_after_while_the_user_thinks(monkeypatch):
    """Failed before: after half a minute the guard took the command for one that hangs."""
    main, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        for answer, yes in ((b"y", True), (b"", False)):

            def wait_until(condition, answer=answer):
                assert not condition()
                os.write(main, answer + b"\n")
                while not condition():
                    pass

            assert ask_yes("Test that?", wait_until) is yes
    os.close(main)
