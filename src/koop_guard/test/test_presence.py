"""Who was restarted, and who only joins."""

import pytest

from koop_guard.config import SAFETY
from koop_guard.presence import Presence

DT = 0.01


def end(program, what):
    """Return the id of an endpoint."""
    return f"{program * 24}{what * 8}"


class Domain:
    """A guard's view of a domain: programs of one letter, each with a publisher and takers."""

    def __init__(self, topics=1, sensor="a", observer="o"):
        self.publishers = {end(sensor, "1")}
        self.takers = [{end("a", str(i + 2)), end(observer, "2")} for i in range(topics)]
        self.presence = Presence(self.publishers, self.takers, DT)
        self.now, self.number, self.again = 10.0, 1000, []

    def run(self, seconds, speaks=True, number=None):
        """Let time pass; return the topics that begin again."""
        again = []
        for _ in range(round(seconds / DT)):
            self.now += DT
            if speaks:
                self.number = self.number + 1 if number is None else number
                number = None
                again += self._look() if not self.presence.continues(self.number) else []
                self.presence.hear(self.number, self.now)
            again += self._look()
        return again

    def _look(self):
        return self.presence.see(self.publishers, self.takers, self.now)

    def join(self, program, publishes=True, topics=None):
        self.publishers |= {end(program, "1")} if publishes else set()
        for i, of in enumerate(self.takers):
            of |= {end(program, str(i + 2))} if topics is None or i in topics else set()

    def leave(self, program):
        self.publishers = {i for i in self.publishers if i[0] != program}
        self.takers = [{i for i in of if i[0] != program} for of in self.takers]


@pytest.mark.parametrize("topics", [1, 2])
@pytest.mark.parametrize("ends", ["in order", "killed", "killed, and forgotten"])
def test_a_rig_that_was_restarted_begins_again_once_and_nothing_is_commanded_in_doubt(ends, topics):
    domain = Domain(topics)
    for before, after in ("ab", "bc"):
        assert domain.run(2.0) == []
        if ends == "in order":
            domain.leave(before)
        assert domain.run(4.0, speaks=False) == []
        domain.join(after, publishes=False)  # it subscribes first
        again = domain.run(0.1, speaks=False)
        assert domain.presence.is_held(domain.now) == (ends != "in order")
        domain.join(after)
        if ends == "killed, and forgotten":
            domain.leave(before)
        again += domain.run(3.0, number=1)
        assert sorted(again) == list(range(topics))
        assert domain.presence.publishers == (end(after, "1"),)
        domain.leave(before)
        assert domain.run(30.0) == []


def test_each_topic_of_the_command_begins_again_as_it_is_subscribed_to_late():
    domain = Domain(2)
    domain.run(1.0)
    domain.run(1.0, speaks=False)
    domain.join("b", topics=[0])
    assert domain.run(20.0, number=1) == [0]
    domain.join("b")
    assert domain.run(20.0) == [1]
    domain.join("p", publishes=False)
    assert domain.run(1.0) == []


def test_who_joins_a_rig_that_lives_is_not_the_rig():
    domain = Domain()
    assert domain.run(1.0) == []
    domain.join("p", publishes=False)  # an observer
    assert domain.run(2 * DT) == []
    assert not domain.presence.is_doubtful
    domain.join("b")  # a second rig
    for _ in range(50):
        assert domain.run(DT) == []
        domain.presence.hear(3, domain.now)
        assert not domain.presence.is_held(domain.now)
    domain.leave("a")
    assert domain.run(20.0, number=60) == []


def test_a_rig_that_is_found_again_was_not_restarted():
    domain = Domain()
    domain.run(1.0)
    left = domain.publishers, [set(of) for of in domain.takers]
    domain.leave("a")
    assert domain.run(30.0, speaks=False) == []
    domain.publishers, domain.takers = left
    assert domain.run(30.0) == []


def test_a_silent_rig_is_commanded_again_soon_after_an_observer_has_joined():
    domain = Domain()
    domain.run(1.0)
    domain.run(1.0, speaks=False)
    domain.join("p", publishes=False)
    assert domain.run(SAFETY.matched, speaks=False) == []
    assert domain.presence.is_held(domain.now)
    assert domain.run(0.1, speaks=False) == []
    assert not domain.presence.is_held(domain.now)


def test_a_sensor_of_its_own_that_was_restarted_leaves_theta_where_it_is():
    domain = Domain(sensor="s")
    domain.run(1.0)
    domain.leave("s")
    domain.run(5.0, speaks=False)
    domain.publishers = {end("t", "1")}
    assert domain.run(20.0, number=1) == []
    assert domain.presence.publishers == (end("t", "1"),)


def test_without_numbers_a_rig_was_restarted_if_it_had_been_silent():
    for silence, again in ((0.0, []), (1.0, [0])):
        domain = Domain()
        for step in range(400):
            domain.now += DT
            if step == 200 and silence:
                domain.now += silence
            if step == 200:
                domain.join("b")
            domain.again += domain._look()
            domain.presence.hear(0, domain.now)
            domain.again += domain._look()
        assert domain.again == again
