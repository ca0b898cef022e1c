"""A rig whose theta is moved by a commander while nodes beside it listen and record."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT
from koop_commission.rig.listener import (
    DISCOVERY,
    Ears,
    refuse_dead,
    refuse_two_rigs,
    refuse_wrong_names,
    speakers,
    two_rigs,
    who_else_commands,
)
from koop_commission.theta.commander_client import Hand, left_at
from koop_commission.theta.limits import silence
from koop_core.config.fields import parse_source
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_node.client.client import Client
from koop_tune.rig.rig_file import STATE, STATE_TYPE, THETA, RigFile

COST = "/cost"
WAITING = 0.1  # [s] in which all is heard that was waiting while this process was held up


class Ended(LiveError):
    """Something ended after theta was moved, and before it was done; theta went home.

    Parameters
    ----------
    reason : str
        What ended it.
    rig : RigFile
        The rig.
    silent : bool
        Whether the rig says nothing any more.
    """

    def __init__(self, reason: str, rig: RigFile, silent: bool) -> None:
        safe = f"{rig.theta_safe:g}"
        where = (
            f"theta was sent back to {safe}, but a rig that is silent may not have heard it"
            if silent
            else f"theta is back at {safe}"
        )
        super().__init__(f"{reason}. {where}")


@dataclass
class Watch:
    """What a session is given besides the rig.

    Attributes
    ----------
    scale : float
        The rig's seconds in one second.
    note : Path or None
        File that says where theta was left.
    check : callable
        Called once a second; it may raise LiveError.
    patience : float
        Time that the rig may take to be found [s].
    """

    scale: float = 1.0
    note: Path | None = None
    check: Callable[[], object] = lambda: None
    patience: float = DISCOVERY


class Session:
    """The rig as it is heard, and theta in hand; :func:`session` makes one.

    Attributes
    ----------
    client : Client
        Guest in the ROS domain.
    nodes : LiveNodes
        Those that run beside.
    ears : Ears
        On the states.
    hand : Hand
        Moves theta.
    still : int
        Samples for which no channel may rest at one value; 0: for ever.
    shown : callable
        Called once a second.
    """

    def __init__(
        self, rig: RigFile, watch: Watch, client: Client, nodes: LiveNodes, ears: Ears
    ) -> None:
        self.client, self.nodes, self.ears = client, nodes, ears
        self.hand: Hand
        self.still = 0
        self.shown: Callable[[], object] = lambda: None
        self._rig, self._watch = rig, watch
        self._looked = self._beat = 0.0

    def check_nodes(self) -> None:
        """Raise LiveError if the recording has ended, or another node."""
        for process in self.nodes.ended():
            *_, last = ["", *process.last_lines(1).splitlines()]
            words = re.sub(r"^(\[[^]]*\] )*(\[[^]]*\]: )?", "", last)
            if not words and not shutil.disk_usage(self.nodes.folder).free:
                words = "no space is left on the disk, not for its log either: make room"
            raise LiveError(f"{process.node} has ended: {words or 'see'} ({process.log})")

    def until(self, condition: Callable[[], object]) -> None:
        """Wait for a condition.

        Raises
        ------
        koop_core.errors.LiveError
            If the rig, a sensor, a node or the disk fails, a limit is crossed, or somebody else
            commands.
        """
        while not condition():
            self.client.spin(0.05)
            self.check()

    def go(self, theta: float) -> None:
        """Move theta, and wait until what is heard is of the time when it had arrived."""
        self.hand.go(theta)
        self.until(lambda: self.hand.there)
        step = self.hand.step
        self.until(lambda: self.ears.last is not None and self.ears.last.step >= step)

    def check(self) -> None:
        """Look after the rig, ten times a second at most; raise as :meth:`until` does."""
        now = time.monotonic()
        if now < self._beat + 0.1:
            return
        self._beat = now
        self.hand.beat()
        if now < self._looked + 1.0:
            return
        self._looked = now
        self.check_nodes()
        self.refuse_dead()
        self._watch.check()
        if text := two_rigs(self.client, self._rig):
            raise LiveError(text)
        if others := who_else_commands(self.client, self._rig.knob.topic, own=True):
            raise LiveError(f"{self._rig.knob.topic} is also commanded by {', '.join(others)}")
        self.shown()

    def silent(self) -> bool:
        """Return whether the rig says nothing any more, also if this process was held up itself."""
        limit, begin = silence(self._rig.dt, self._watch.scale), time.monotonic()
        if not self.ears.silent > limit:  # NaN if it has not begun
            return False
        while (passed := time.monotonic() - begin) < limit:
            self.client.spin(0.05)
            if self.ears.silent < passed - WAITING:
                return False
        return True

    def refuse_dead(self) -> None:
        """Raise LiveError if a channel has not changed for ``still`` samples."""
        if not 0 < self.still <= self.ears.count:
            return
        refuse_dead(self._rig.names, self.ears.samples(self.ears.count - self.still).x)


@contextmanager
def session(
    name: str,
    rig: RigFile,
    watch: Watch,
    nodes: LiveNodes,
    began: Callable[[], object] = lambda: None,
    follows: str = "",
) -> Iterator[Session]:
    """Listen to a rig with nodes beside, and hold its theta; at the end theta goes home first.

    Parameters
    ----------
    name : str
        Of the guest in the ROS domain.
    rig : RigFile
        The rig, which runs.
    watch : Watch
        How it is watched.
    nodes : LiveNodes
        Lifter and recorder, and what else runs beside.
    began : callable
        Called once they are started.
    follows : str
        Topic of a controller, whose theta the hand can follow.

    Raises
    ------
    koop_core.errors.LiveError
        Ended if theta had been moved.
    koop_core.config.parameter.ConfigError
        If the rig file names what is not there.
    """
    # the commander ends after the recorder: what is recorded has a theta to the last state
    with ExitStack() as last, ExitStack() as stack:
        client = stack.enter_context(Client(name))
        refuse_wrong_names(client, rig, watch.patience, watch.check)
        refuse_two_rigs(client, rig)
        stack.enter_context(nodes)
        began()
        channels = ",".join(f"x[{i}]" for i in range(len(rig.names)))
        source = rig.measured if rig.speaks_state else f"{STATE}:{channels}"
        kind = rig.measured_type if rig.speaks_state else STATE_TYPE
        parsed = parse_source(source)
        ears = Ears(client, parsed.topic, kind, parsed.fields, reliable=True)
        run = Session(rig, watch, client, nodes, ears)
        client.wait_for(
            lambda: client.node.count_subscribers(THETA) and client.node.count_publishers(COST),
            START_TIMEOUT, f"lifter and recorder (see {nodes.folder}/logs)", run.check_nodes,
        )  # fmt: skip
        if others := who_else_commands(client, rig.knob.topic, own=False):
            raise LiveError(f"{rig.knob.topic} is commanded by {', '.join(others)}: end that first")
        theta, words = left_at(watch.note, rig, speakers(client, rig.state.topic))
        if words:
            print(words, flush=True)
        log = nodes.folder / "logs" / "commander.log"
        try:
            run.hand = last.enter_context(
                Hand(rig, log, source, kind, watch.scale, 1, watch.note, follows, theta)
            )
            stack.callback(run.hand.come_home)
            yield run
        except LiveError as error:
            raise Ended(str(error), rig, run.silent()) from error


def refuse_incomplete_state(rig: RigFile) -> None:
    """Refuse a rig that speaks on the loop's own topic, of which not all channels are named."""
    if rig.state.topic == STATE and not rig.speaks_state:
        raise ConfigError(
            f"measured = {rig.measured!r}: on {STATE} the lifter takes all of {STATE_TYPE}: name "
            "x[0], x[1] and so on in order, or let the rig publish on another topic"
        )
