"""The executor of the nodes, with rclpy's own entities over DDS."""

import math
import os
import time

import pytest
import rclpy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from koop_core.wakeup import make_turns, wait
from koop_node.node.executor import AT_ONCE, Executor
from koop_node.node.rclpy_internals import WithoutEvents


@pytest.fixture
def node(own_domain):
    context = rclpy.Context()
    context.init(args=[])
    node = WithoutEvents("worker", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


@pytest.fixture
def executor(node):
    executor = Executor()
    executor.add_node(node)
    yield executor
    executor.shutdown()


def run_until(executor, condition):
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        executor.run(0.05)


def test_all_that_has_come_is_called_back_in_order_and_others_have_their_turn(node, executor):
    many, one = [], []
    publishers = {}
    for topic, callback in (("many", many.append), ("one", lambda m: one.append(len(many)))):
        node.create_subscription(Float64, topic, callback, 10 * AT_ONCE)
        publishers[topic] = node.create_publisher(Float64, topic, 10 * AT_ONCE)
    run_until(executor, lambda: all(p.get_subscription_count() for p in publishers.values()))
    for i in range(5 * AT_ONCE):
        publishers["many"].publish(Float64(data=float(i)))
    publishers["one"].publish(Float64())
    run_until(executor, lambda: one and len(many) == 5 * AT_ONCE)
    assert [message.data for message in many] == list(range(5 * AT_ONCE))
    assert one[0] <= AT_ONCE


def test_services_and_clients_that_share_a_descriptor_answer_each_other(node, executor):
    calls = []

    def answer(request, response):
        calls.append(request)
        response.message = str(len(calls))
        return response

    for name in ("first", "second"):
        node.create_service(Trigger, name, answer)
    clients = [node.create_client(Trigger, name) for name in ("first", "second")]
    run_until(executor, lambda: all(client.service_is_ready() for client in clients))
    futures = [client.call_async(Trigger.Request()) for client in clients * 3]
    run_until(executor, lambda: all(future.done() for future in futures))
    assert sorted(future.result().message for future in futures) == list("123456")


def test_compiled_code_wakes_for_its_messages_and_leaves_all_else_to_python(node, executor):
    heard, calls = [], []
    hot = node.create_subscription(Float64, "hot", heard.append, 10)
    publisher = node.create_publisher(Float64, "hot", 10)
    node.create_subscription(Float64, "other", calls.append, 10)
    other = node.create_publisher(Float64, "other", 10)
    run_until(executor, publisher.get_subscription_count)
    run_until(executor, other.get_subscription_count)

    turns = make_turns(1, 1)
    turns.lent[0], turns.descriptors[0] = True, executor.descriptor(hot)

    def wait_for(seconds, due=math.inf):
        begin = time.monotonic()
        turns.due[0] = begin + due
        return wait(executor.wakeup(begin + seconds), turns)

    publisher.publish(Float64(data=1.0))
    assert wait_for(60.0)
    assert not wait_for(0.01)  # it is woken once
    executor.run(0.0)
    assert not heard  # nobody but the code is told
    os.eventfd_write(executor.descriptor(hot), AT_ONCE)  # which has left it
    run_until(executor, lambda: heard)
    assert wait_for(60.0, due=0.01)  # by the time
    assert not wait_for(0.01, due=60.0)
    other.publish(Float64())
    assert not wait_for(60.0)
    run_until(executor, lambda: calls)
    assert not wait_for(-1.0)


def test_what_a_callback_destroys_is_not_called_and_what_it_makes_is(node, executor):
    heard, made = [], []

    def destroy_and_make(message):
        while made:
            node.destroy_subscription(made.pop())
        node.create_subscription(Float64, "later", heard.append, 10)

    node.create_subscription(Float64, "now", destroy_and_make, 10)
    made.append(node.create_subscription(Float64, "now", lambda message: heard.append("?"), 10))
    now, later = (node.create_publisher(Float64, name, 10) for name in ("now", "later"))
    run_until(executor, lambda: now.get_subscription_count() == 2)
    while made:  # whichever of the two DDS tells of first
        now.publish(Float64())
        executor.run(0.05)
    before = len(heard)
    now.publish(Float64())
    run_until(executor, later.get_subscription_count)
    later.publish(Float64(data=5.0))
    run_until(executor, lambda: len(heard) > before)
    assert heard[-1] == Float64(data=5.0)
    executor.remove_node(node)
    later.publish(Float64(data=6.0))
    executor.run(0.2)
    assert heard[-1] == Float64(data=5.0)
