"""State of a guarded rig's loop, kept for its next start.

It is the controller's state, which is on /diagnostics once a second, and the parameters of lifter
and controller that were set while they ran. The file is written where no message waits for the
disk: in the process that watches the nodes.
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

Parameters = dict[str, dict[str, Any]]
PERIOD = 1.0  # [s] between two times that it is written
CONFIGS: dict[str, type] = {"koopman_lifter": LifterConfig, "relay_esc": EscConfig}
OF = {
    "koop_guard": {"measured", "command"},
    **{node: names_of([config]) - {"begin"} for node, config in CONFIGS.items()},
}
"""Parameters with which it is worth something."""
SET = OF | {"koopman_lifter": OF["koopman_lifter"] | {"model", "begin"}}
"""Parameters that outlive the loop if they are set while it runs."""


class Memory:
    """The file of one loop, beside the guard's note; without a guard there is none."""

    def __init__(self, planned: Plan) -> None:
        note = planned.parameters.get("koop_guard", {}).get("note")
        self._path = Path(note).with_suffix(".controller") if note else None
        self._of = _describe(planned.parameters) if note else {}
        self._parameters = {node: dict(items) for node, items in planned.parameters.items()}
        self._changed: Parameters = {}
        self._written: dict[str, Any] = {}
        self._time, self._failed = 0.0, False

    def recall(self) -> tuple[Parameters, str]:
        """Return parameters that take the place of the file's, and a remark."""
        if self._path is None or not self._path.exists():
            return {}, ""
        try:
            values = read_json(self._path)
            of = dict(values["of"])
            names = of.keys() | self._of.keys()
            if others := sorted(name for name in names if of.get(name) != self._of.get(name)):
                raise ConfigError(f"{self._path} is of another {', '.join(others)}")
            changed = {node: dict(dict(values["changed"]).get(node, {})) for node in CONFIGS}
            model = changed["koopman_lifter"].get("model")
            if model is not None and not Path(model).is_file():
                raise ConfigError(f"{model}, the model that was set while the loop ran, is gone")
            begin = {"relay_esc": {"begin": values["begin"]}}
            for node, config in CONFIGS.items():
                used = self._parameters[node] | changed[node] | begin.get(node, {})
                config(**{name: used[name] for name in names_of([config]) & used.keys()})
        except (ConfigError, KeyError, TypeError, ValueError) as error:
            return {}, f"{error}: the controller begins at theta_initial"
        self._changed = changed
        texts = [f"{node}.{k} = {v}" for node, items in changed.items() for k, v in items.items()]
        remark = "the controller resumes where it was when the loop ended"
        try:
            write_json(self._path, values)
        except LiveError as error:
            remark = f"{error}: the controller resumes where it was when that could be written last"
        remark += f", with what was set while it ran: {', '.join(texts)}" if texts else ""
        return {node: changed[node] | begin.get(node, {}) for node in CONFIGS}, remark

    def keep(self, progress: Progress) -> None:
        """Write what the controller said last, if it is time and the rig follows it."""
        try:
            begin = json.loads(progress.values.get("relay_esc", {}).get("begin", "null"))
        except (ValueError, RecursionError):  # another program says so
            return
        follows = progress.values.get("koop_guard", {}).get("status") == "following"
        due = time.monotonic() > self._time + PERIOD
        if self._path is None or not (follows and due and begin):
            return
        changed = {
            node: self._changed.get(node, {})
            | {k: v for k, v in progress.changed.get(node, {}).items() if k in SET[node]}
            for node in CONFIGS
        }
        content = {"of": self._of, "changed": changed, "begin": begin}
        if content == self._written:
            return
        self._time = time.monotonic()
        try:
            write_json(self._path, content)
            self._written, self._failed = content, False
        except (LiveError, TypeError) as error:  # another program may have set a parameter to bytes
            if not self._failed:
                begin = "where that says" if self._path.exists() else "at theta_initial"
                print(f"\nnote: {error}: a restart begins {begin}", file=sys.stderr)
            self._failed = True


def _describe(parameters: Parameters) -> dict[str, Any]:
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
