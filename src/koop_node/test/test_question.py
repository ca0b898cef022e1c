"""A call whose answer is lost is made again."""

from __future__ import annotations

from types import SimpleNamespace

from koop_node.client.question import ASK_AGAIN, Question


class Server:
    """Throws away the first answers."""

    def __init__(self, lost):
        self.lost, self.calls = lost, 0

    def call_async(self, request):
        self.calls += 1
        there = self.calls > self.lost
        return SimpleNamespace(done=lambda: there, result=lambda: f"answer to {request}")


def test_an_answer_that_is_lost_is_asked_for_again(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("koop_node.client.question.time", SimpleNamespace(monotonic=lambda: now[0]))
    server = Server(lost=2)
    asked = Question(server, "this")
    assert asked.answer() is None
    now[0] = 0.5 * ASK_AGAIN
    assert asked.answer() is None
    assert server.calls == 1, "not yet"
    now[0] = 1.1 * ASK_AGAIN
    assert asked.answer() is None
    now[0] = 2.2 * ASK_AGAIN
    assert asked.answer() == "answer to this"
    assert server.calls == 3
