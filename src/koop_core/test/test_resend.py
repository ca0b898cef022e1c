"""Asking, waiting, asking again: what the plant does in lockstep."""

from koop_core.stream.resend import Due, Resend


def test_an_answer_in_time_is_waited_for_in_peace():
    question = Resend(2.0, 3)
    assert question.check(100.0) is Due.WAIT  # nothing was asked
    question.ask(100.0)
    assert question.open
    assert question.check(101.9) is Due.WAIT
    assert question.close() is False
    assert not question.open
    assert question.check(200.0) is Due.WAIT


def test_it_is_asked_again_a_timeout_after_it_was_last_asked_then_given_up():
    question = Resend(2.0, 3)
    question.ask(0.0)
    due = {t: question.check(t) for t in (1.0, 2.5, 4.0, 4.5, 6.5, 8.0, 8.5, 9.0)}
    assert [t for t, what in due.items() if what is Due.AGAIN] == [2.5, 4.5, 6.5]
    assert [t for t, what in due.items() if what is Due.GIVE_UP] == [8.5, 9.0]


def test_a_late_answer_is_known_as_late_and_the_next_question_is_new():
    question = Resend(1.0, 1)
    question.ask(0.0)
    assert question.check(1.0) is Due.AGAIN
    assert question.overdue
    assert question.close() is True
    question.ask(5.0)
    assert (question.overdue, question.resent) == (False, 0)
    assert question.check(6.0) is Due.AGAIN


def test_a_timeout_of_0_waits_for_ever():
    question = Resend(0.0, 3)
    question.ask(0.0)
    assert question.check(1e9) is Due.WAIT
