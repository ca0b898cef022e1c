"""A live rig whose theta a guard moves, and the nodes beside it that listen and record."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from koop_bringup.live.loop import LiveNodes
from koop_bringup.live.process import START_TIMEOUT, uninterrupted
from koop_commission.fitness.samples import refuse_dead
from koop_commission.rig.graph import (
    describe_other_commanders,
    describe_second_rig,
    find_types,
)
from koop_commission.rig.guarded_theta import GuardedTheta
from koop_commission.rig.listener import Listener
from koop_core.config.fields import parse_field, parse_source
from koop_core.config.knobs import format_knobs
from koop_core.config.parameter import ConfigError
from koop_core.errors import LiveError
from koop_guard.note import find_theta
from koop_loop.ending import describe_end
from koop_node.client.client import Client
from koop_node.node.graph import identify_publishers
from koop_tune.rig.rig_file import STATE, STATE_TYPE, RigFile, state_source

COST, COST_TYPE = "/cost", "koop_msgs/msg/Cost"
GONE = 3.0  # [s] in which DDS forgets a program that has ended
BYTES = 250.0  # of a bag for one state, with its cost and theta
BAR = "{desc} |{bar}| {n:.0f}/{total:.0f} s{postfix}"


class Session:
    """The samples of a rig, and its theta.

    ``command_types`` are the message types of the command's topics, ``pkg/msg/Type``, ``nodes`` the
    guard and what runs beside; ``note`` is the file that notes where theta was left.

    Attributes
    ----------
    theta : GuardedTheta
        Moves theta, within :meth:`command_theta`.
    still : int
        Samples after which a channel that does not change is dead; 0: never.
    show : callable
        Called once a second, to draw the progress.
    """

    def __init__(
        self,
        rig: RigFile,
        client: Client,
        listener: Listener,
        command_types: Sequence[str],
        nodes: LiveNodes,
        note: Path | None = None,
    ) -> None:
        self.client, self.listener = client, listener
        publishers = identify_publishers(client.node, rig.measured_source.topic)
        theta, remark = find_theta(note, rig, publishers)
        if remark:
            print(remark, flush=True)
        self.theta = GuardedTheta(client, rig, command_types, theta)
        self.still = 0
        self.show: Callable[[], object] = lambda: None
        self._phase = "moving theta"
        self._rig, self._nodes = rig, nodes
        self._bar = tqdm(desc=self._phase, bar_format=BAR, leave=False, disable=None, total=1.0)
        self._checked = self._looked = 0.0

    @contextmanager
    def command_theta(self) -> Iterator[None]:
        """Begin to command theta; at the end it returns to theta_safe.

        Raises
        ------
        koop_core.errors.LiveError
            If it ends early, or theta may not be at theta_safe.
        """
        reason = ""
        try:
            self.theta.go(self.theta.value)
            self.client.wait_for(
                lambda: self.theta.arrived, START_TIMEOUT,
                f"the guard (see {self._nodes.folder}/logs)", self.check,
            )  # fmt: skip
            try:
                yield
            except LiveError as error:
                reason = f"{error}. "
                where = f"theta was returned to theta_safe = {self._rig.spell('theta_safe')}"
                raise LiveError(f"{reason}{where}") from error
        finally:
            with uninterrupted():
                self._bar.close()
                self._nodes.stop_guard()
                try:
                    self.theta.wait_until_safe()
                except LiveError as error:
                    raise LiveError(f"{reason}{error}") from None

    def silenced(self, seconds: float) -> AbstractContextManager[None]:
        """Command nothing for at most so many seconds; end the session afterwards."""
        return self._nodes.silenced(seconds)

    def check_nodes(self) -> None:
        """Raise LiveError if the recorder or another node has ended."""
        for process in self._nodes.ended():
            if (code := process.process.returncode) < 0:
                raise LiveError(describe_end(process.node, code))
            *_, last = ["", *process.last_lines(1).splitlines()]
            words = re.sub(r"^(\[[^]]*\] )*(\[[^]]*\]: )?", "", last)
            if not words and not shutil.disk_usage(process.log.parent).free:
                words = "no space is left on the disk, not even for its log: make room"
            raise LiveError(f"{process.node} has ended: {words or 'see'} ({process.log})")

    def wait_until(self, condition: Callable[[], object]) -> None:
        """Wait for a condition.

        Raises
        ------
        koop_core.errors.LiveError
            If the rig, a sensor, a node or the disk fails, a limit is crossed, or another
            publisher commands theta.
        """
        while not condition():
            self.client.spin(0.05)
            self.check()

    def wait_for_states(self, count: int, phase: str = "listening") -> None:
        """Wait for some states and show the progress; raise as :meth:`wait_until` does."""
        first, dt = self.listener.count, self._rig.dt
        self.show = lambda: self.draw(phase, (self.listener.count - first) * dt, count * dt)
        self.wait_until(lambda: self.listener.count >= first + count)

    def listen_to_margins(self) -> Listener:
        """Return a listener to the margin of the constraint, which each cost tells."""
        return Listener(self.client, COST, COST_TYPE, (parse_field("margin"),), reliable=True)

    def go(self, theta: Sequence[float]) -> None:
        """Move theta, and wait for the first state after its arrival."""
        self.theta.go(theta)
        self.wait_until(lambda: self.theta.arrived)
        count = self.listener.count
        self.wait_until(lambda: self.listener.count > count)

    def check(self) -> None:
        """Look after the rig, ten times a second at most; raise as :meth:`wait_until` does."""
        now = time.monotonic()
        if now < self._checked + 0.1:
            return
        self._checked = now
        self._nodes.answer(self._describe)
        self.theta.check()
        if now < self._looked + 1.0:
            return
        self._looked = now
        self.check_nodes()
        self.refuse_dead()
        self.show()

    def hide(self) -> None:
        """Show no progress until the next phase."""
        self.show = lambda: None
        self._bar.clear()

    def draw(self, phase: str, elapsed: float, total: float, more: str = "") -> None:
        """Draw the progress of a phase, in seconds."""
        self._phase = f"{phase}, {elapsed:.0f} of {total:.0f} s"
        self._bar.set_description_str(phase, refresh=False)
        self._bar.total, self._bar.n = total, min(elapsed, total)
        words = f"theta {format_knobs(self.theta.value, '+.4g')}" + f", {more}" * bool(more)
        self._bar.set_postfix_str(words, refresh=True)

    def _describe(self) -> dict[str, Any]:
        """Return the answer to ``koop status``."""
        folder = self._nodes.folder
        theta = format_knobs(self.theta.value, "+.4g")
        text = f"  commissioning in {folder}: {self._phase}; theta = {theta}"
        places = [str(path.resolve()) for path in (folder, *folder.parents[:2])]
        return {"healthy": True, "text": text, "places": places}

    def refuse_dead(self) -> None:
        """Raise LiveError if a channel has not changed for ``still`` samples."""
        if 0 < self.still <= self.listener.count:
            newest = self.listener.samples(self.listener.count - self.still)
            refuse_dead(self._rig.names, newest.x)


@contextmanager
def open_session(rig: RigFile, nodes: LiveNodes, note: Path | None = None) -> Iterator[Session]:
    """Start the nodes beside a rig and command its theta; at the end theta returns first.

    ``nodes`` are guard, lifter and recorder, and others that run beside; ``note`` is the file that
    notes where theta was left.

    Raises
    ------
    koop_core.errors.LiveError
        If it ends early; theta has returned to theta_safe then.
    koop_core.config.parameter.ConfigError
        If the rig file names what does not exist.
    """
    refuse_incomplete_state(rig)
    with Client("_koop_session") as client:  # hidden: the guard waits for the rig to listen
        _, command_types = find_types(client, rig)
        for describe in (describe_second_rig, describe_other_commanders):
            with suppress(LiveError):  # a program that has just ended is still listed
                client.wait_for(lambda: not describe(client, rig), GONE, "others")  # noqa: B023
            if text := describe(client, rig):
                raise LiveError(text)
        with nodes:
            state = parse_source(state_source(len(rig.names)))
            listener = Listener(client, state.topic, STATE_TYPE, state.fields, reliable=True)
            session = Session(rig, client, listener, command_types, nodes, note)
            client.wait_for(
                lambda: client.node.count_subscribers(COST) and client.node.count_publishers(COST),
                START_TIMEOUT, f"lifter and recorder (see {nodes.folder}/logs)",
                session.check_nodes,
            )  # fmt: skip
            with session.command_theta():
                yield session


@contextmanager
def resumable(rig: RigFile, command: str) -> Iterator[None]:
    """Say, if a command is interrupted or fails on the rig, how it is resumed."""
    try:
        yield
    except LiveError as error:
        raise LiveError(f"{error}; to resume: {command}") from None
    except KeyboardInterrupt:
        back = f"theta is back at {rig.spell('theta_safe')}, or was not moved"
        print(f"\n{back}; to resume: {command}")
        raise


def spell_time(seconds: float, pace: float) -> str:
    """Return a time of the rig in words, and how long it takes here where that differs.

    >>> spell_time(40.0, 1.0), spell_time(600.0, 1.0), spell_time(1200.0, 4.0)
    ('40 s', '600 s (10 min)', "1200 s of the rig's time (5 min here)")
    """
    here = seconds / pace
    wait = f"{here:.0f} s" if here < 120.0 else f"{here / 60.0:.2g} min"
    if pace != 1.0:
        return f"{seconds:.0f} s of the rig's time ({wait} here)"
    return f"{seconds:.0f} s" + f" ({wait})" * (here >= 120.0)


def refuse_incomplete_state(rig: RigFile) -> None:
    """Refuse a rig that publishes the loop's own topic, and a rig file that names only a part.

    Raises
    ------
    koop_core.config.parameter.ConfigError
        If it is such a rig.
    """
    if rig.measured_source.topic == STATE and not rig.speaks_state:
        raise ConfigError(
            f"measured = {rig.measured!r}: on {STATE} the lifter takes all of {STATE_TYPE}: name "
            "x[0], x[1] and so on in order, or let the rig publish on another topic"
        )


def refuse_small_disk(rig: RigFile, folder: Path, seconds: float) -> None:
    """Refuse a disk that has no room for a recording of some time [s].

    Raises
    ------
    koop_core.errors.LiveError
        If it has none.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    needed = BYTES * max(seconds, 0.0) / rig.dt
    if free < needed:
        raise LiveError(
            f"{existing}: {free / 1e6:.0f} MB are free, up to {needed / 1e6:.0f} MB are needed: "
            "make room, or set a shorter 'time' in the rig file"
        )
