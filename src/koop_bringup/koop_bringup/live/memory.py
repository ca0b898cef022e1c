"""State of a guarded rig's controller, kept for the next start of the loop.

The controller says it on /diagnostics once a second. So the file is written where no message waits
for the disk: in the process that watches the nodes.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

from koop_bringup.live.monitor import Progress
from koop_bringup.plan import Plan
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_core.whole_file import read_json, write_json
from koop_loop.parameters import names_of
from koopman_lifter.config import LifterConfig
from relay_esc.config import EscConfig

PERIOD = 1.0  # [s] between two times that it is written
OF = {
    "koop_guard": {"measured", "command"},
    "koopman_lifter": names_of([LifterConfig]),
    "relay_esc": names_of([EscConfig]) - {"begin"},
}
"""Parameters with which it is worth something."""


class Memory:
    """The file of one loop, beside the guard's note; without a guard there is none.

    Parameters
    ----------
    planned : Plan
        The loop.
    """

    def __init__(self, planned: Plan) -> None:
        note = planned.parameters.get("koop_guard", {}).get("note")
        self._path = Path(note).with_suffix(".controller") if note else None
        self._of = _describe(planned.parameters) if note else {}
        self._written, self._time = "", 0.0

    def recall(self) -> tuple[list[float], str]:
        """Return the controller's parameter ``begin``, and a remark where it is not as noted."""
        if self._path is None:
            return [], ""
        try:
            values = read_json(self._path)
            of = dict(values.get("of", self._of))
            names = of.keys() | self._of.keys()
            if others := sorted(name for name in names if of.get(name) != self._of.get(name)):
                raise ConfigError(f"{self._path} is of another {', '.join(others)}")
            return list(EscConfig(begin=tuple(values.get("begin", ()))).begin), ""
        except (ConfigError, TypeError, ValueError) as error:
            return [], f"{error}: the controller begins at theta_initial"

    def keep(self, progress: Progress) -> None:
        """Write what the controller said last, if it is time and the rig follows it."""
        text = progress.values.get("relay_esc", {}).get("begin", "")
        follows = progress.values.get("koop_guard", {}).get("status") == "following"
        due = time.monotonic() > self._time + PERIOD
        if self._path is None or not follows or not due or text in ("", self._written):
            return
        self._written, self._time = text, time.monotonic()
        try:
            write_json(self._path, {"of": self._of, "begin": json.loads(text)})
        except LiveError as error:
            print(f"\nnote: {error}: a restart begins at theta_initial", file=sys.stderr)
            self._path = None


def _describe(parameters: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the parameters that a file is of, as a file holds them, and the model's hash."""
    of = {
        f"{node}.{name}": value
        for node, names in OF.items()
        for name, value in parameters[node].items()
        if name in names
    }
    if model := parameters["koopman_lifter"].get("model"):
        content = Path(model).expanduser().read_bytes() if Path(model).is_file() else b""
        of["model"] = hashlib.sha256(content).hexdigest()
    return dict(json.loads(json.dumps(of)))
