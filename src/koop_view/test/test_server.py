"""The server, over real connections: who gets in, what a client gets, what it may not do."""

import asyncio
import json
import struct
import threading
import urllib.request
from contextlib import suppress
from http.client import HTTPConnection
from urllib.error import HTTPError

import pytest
from koop_view_running import TIMEOUT, client, closed_with, heard, running, tell
from websockets.exceptions import ConnectionClosed, InvalidStatus

from koop_bag.bag.writer import BagWriter
from koop_bag.cdr.schema import MessageSchema, load_schema
from koop_bag.errors import BagError
from koop_core.config.parameter import ConfigError
from koop_view.config import ViewConfig
from koop_view.protocol import SUBPROTOCOLS, AdvertisedChannel, AdvertisedService
from koop_view.recorded import RecordedSource
from koop_view.server import CLIENTS, ViewServer
from koop_view.session import Refused, ViewSource

TOKEN = "a-token-of-24-characters"


class FakeLoop(ViewSource):
    """A channel that sends without end, and two services."""

    mode = "live"

    def __init__(self):
        super().__init__()
        self.channels = {1: AdvertisedChannel(1, "/gush", "std_msgs/msg/String", "string data")}
        for number, name in enumerate(["/reset", "/hold"], 1):
            self.services[number] = AdvertisedService(number, name, "a/srv/B", "", "")
        self.parameters = {"/esc.dwell": 1.0, "/esc.name": "a"}
        self.asked, self.logged = [], []
        self.ended = threading.Event()

    def subscribe(self, viewer, wanted):
        async def gush():
            while True:
                viewer.deliver(next(iter(wanted)), 5, bytes(500_000))
                await asyncio.sleep(0.001)

        self.task = asyncio.get_running_loop().create_task(gush())
        self.task.add_done_callback(lambda task: self.ended.set())

    def unsubscribe(self, viewer, subscription, channel):
        self.task.cancel()

    async def call(self, service, payload, peer):
        self.asked.append((service.name, payload))
        if payload == b"no":
            raise Refused("it cannot")
        self.parameters.update({"/esc.dwell": 2.0, "/late.dwell": 3.0})
        for session in self.sessions:
            session.send_parameters(self.parameters)
        return b"\0\1\0\0yes"

    def log(self, text):
        self.logged.append(text)


@pytest.fixture(scope="module")
def loop():
    return FakeLoop()


@pytest.fixture(scope="module")
def port(loop):
    with running(loop, TOKEN, origins=("https://good.example",)) as port:
        yield port


def call(connection, service, payload, number=1):
    """Call a service; return its answer, or why it failed."""
    connection.send(struct.pack("<BIII", 2, service, number, 3) + b"cdr" + payload)
    while True:
        message = connection.recv(10)
        if isinstance(message, bytes) and message[0] == 3:
            assert struct.unpack_from("<III", message, 1) == (service, number, 3)
            return message[16:]
        if isinstance(message, str) and json.loads(message)["op"] == "serviceCallFailure":
            return json.loads(message)["message"]


def refused(port, **options):
    """Return the status with which a connection is refused."""
    with pytest.raises(InvalidStatus) as error:
        client(port, **options)
    return error.value.response.status_code


def test_the_page_is_on_the_same_port(port):
    headers = {"Origin": "http://evil.example"}  # the page alone tells nothing
    page = urllib.request.Request(f"http://127.0.0.1:{port}/#token=x", headers=headers)
    with urllib.request.urlopen(page) as answer:
        assert b"<!doctype html>" in answer.read().lower()[:100]
        assert "script-src 'sha256-" in answer.headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert "Access-Control-Allow-Origin" not in answer.headers
    with pytest.raises(HTTPError, match="404"):
        urllib.request.urlopen(f"http://127.0.0.1:{port}/etc/passwd")
    rebound = HTTPConnection("127.0.0.1", port)
    rebound.request("GET", "/", headers={"Host": f"evil.example:{port}"})
    assert rebound.getresponse().status == 421
    rebound.close()


@pytest.mark.parametrize("name", SUBPROTOCOLS)
def test_viewers_of_any_age_connect(port, name):
    with client(port, subprotocols=[name]) as viewer:
        assert viewer.subprotocol == name
        info = heard(viewer, "serverInfo")
        assert info["metadata"]["koop_operate"] == "false"
        assert heard(viewer, "advertise")["channels"][0]["schemaEncoding"] == "ros2msg"


def test_no_page_of_another_origin_and_no_other_protocol_gets_in(port, loop):
    assert refused(port, origin="http://evil.example") == 403
    assert refused(port, origin="null") == 403
    assert refused(port, origin="http://evil.example", token=TOKEN) == 403
    assert refused(port, subprotocols=["another.v1"]) == 400
    assert refused(port, subprotocols=None) == 400
    for origin in (f"http://127.0.0.1:{port}", "https://good.example"):
        client(port, origin=origin).close()
    assert any("evil.example" in line for line in loop.logged)


def test_a_client_without_the_token_reads_and_may_not_operate(port, loop):
    with client(port, "wrong") as viewer:
        assert heard(viewer, "serverInfo")["metadata"]["koop_operate"] == "false"
        loop.asked.clear()
        assert "may only read" in call(viewer, 2, b"x")
        tell(viewer, "setParameters", parameters=[{"name": "/esc.dwell", "value": 9.0}], id="s")
        assert "not offered" in heard(viewer, "status")["message"]
    assert loop.asked == []


def test_a_client_with_the_token_operates_and_others_see_it(port, loop):
    with client(port) as other, client(port, TOKEN) as operator:
        assert heard(operator, "serverInfo")["metadata"]["koop_operate"] == "true"
        names = [service["name"] for service in heard(operator, "advertiseServices")["services"]]
        assert names == ["/reset", "/hold"]
        assert call(operator, 2, b"no") == "it cannot"
        assert "no service" in call(operator, 77, b"x")
        tell(other, "subscribeParameterUpdates", parameterNames=["/esc.dwell", "/late.dwell"])
        tell(other, "getParameters", parameterNames=["/esc.dwell"], id="g")
        assert heard(other, "parameterValues")["id"] == "g"
        assert call(operator, 2, b"x") == b"\0\1\0\0yes"
        changed = heard(other, "parameterValues")["parameters"]
        assert changed == [
            {"name": "/esc.dwell", "value": 2.0},
            {"name": "/late.dwell", "value": 3.0},  # of a node that came after the subscription
        ]


def test_a_client_that_does_not_keep_up_is_dropped_and_told_why(port, loop):
    with client(port, max_queue=1) as slow:
        tell(slow, "subscribe", subscriptions=[{"id": 1, "channelId": 1}])
        slow.recv(10)
        assert loop.ended.wait(TIMEOUT)  # without reading
        code, reason = closed_with(slow)
    assert code == 1008
    assert "too slow" in reason


@pytest.mark.parametrize(
    ("host", "message"),
    [("127.0.0.1", "port {} is taken"), ("a..b", "'a..b' is not an address or a name")],
)
def test_an_address_that_cannot_be_had_is_an_error_in_words(port, host, message):
    async def start():
        async with ViewServer(FakeLoop(), ViewConfig(host, port), "").listen():
            pass

    with pytest.raises(ConfigError, match=message.format(port)):
        asyncio.run(start())


def test_there_are_no_more_clients_than_allowed_and_no_message_is_too_long(port):
    several = [client(port) for _ in range(CLIENTS)]
    assert refused(port) == 503
    several[0].send("x" * 300_000)
    assert closed_with(several[0])[0] == 1009
    for connection in several:
        connection.close()


def test_a_client_with_too_many_requests_is_dropped_and_told_why(port):
    with client(port) as greedy:
        with suppress(ConnectionClosed):
            for _ in range(2000):  # twice the messages that may come at once
                greedy.send("{}")
        assert closed_with(greedy) == (1008, "too many messages")


@pytest.fixture
def recording(tmp_path):
    """Return the folder of a bag with three topics, and its messages."""
    schema = load_schema("std_msgs/msg/String")
    written = []
    with BagWriter(tmp_path / "bag") as bag:
        channels = {name: bag.add_topic(name, schema) for name in ("/a", "/b", "/c")}
        for k in range(3000):
            name = ("/a", "/b", "/c")[k % 3]
            data = b"\0\1\0\0" + struct.pack("<I", 5) + b"%4d\0" % k
            bag.write(channels[name], 1000 + k, 0, data)
            written.append((name, 1000 + k, data))
    return tmp_path, written


def subscribe(viewer, topics):
    """Subscribe to topics, by the number of the subscription."""
    offered = {item["topic"]: item for item in heard(viewer, "advertise")["channels"]}
    assert offered["/a"]["schema"] == load_schema("std_msgs/msg/String").text
    pairs = [{"id": n, "channelId": offered[topic]["id"]} for n, topic in topics.items()]
    tell(viewer, "subscribe", subscriptions=pairs)


def received(viewer, topics):
    """Return the messages until the recording is complete."""
    messages = []
    while isinstance(message := viewer.recv(TIMEOUT), bytes):
        _, number, time = struct.unpack_from("<BIQ", message)
        messages.append((topics[number], time, message[13:]))
    assert json.loads(message) == {"op": "status", "level": 0, "message": "recording complete"}
    return messages


def test_a_recording_comes_whole_and_in_its_order(recording):
    folder, written = recording
    topics = {1: "/a", 2: "/c"}
    with running(RecordedSource(folder)) as port, client(port) as viewer:
        assert heard(viewer, "serverInfo")["metadata"]["koop_mode"] == "recorded"
        subscribe(viewer, topics)
        assert received(viewer, topics) == [item for item in written if item[0] != "/b"]


def test_a_topic_of_a_recording_goes_on_when_another_is_unsubscribed(recording):
    folder, written = recording
    topics = {1: "/a", 2: "/c"}
    with running(RecordedSource(folder)) as port, client(port) as viewer:
        subscribe(viewer, topics)
        tell(viewer, "unsubscribe", subscriptionIds=[1])
        messages = [item for item in received(viewer, topics) if item[0] == "/c"]
    assert messages == [item for item in written if item[0] == "/c"]


def test_a_recording_is_complete_when_all_that_a_client_asked_for_has_come(recording):
    """Failed before: a loop chosen while another was being read was said to be complete."""

    class Viewer:
        delivered, complete = 0, ()

        async def deliver_slowly(self, number, time, data):
            self.delivered += 1
            await asyncio.sleep(0)
            return True

        def say(self, level, text):
            self.complete += (self.delivered,)

    async def read():
        source, viewer = RecordedSource(recording[0]), Viewer()
        first, _, last = source.channels.values()
        source.subscribe(viewer, {1: first})
        while viewer.delivered < 500:
            await asyncio.sleep(0)
        source.subscribe(viewer, {2: last})
        while source._tasks:
            await asyncio.sleep(0)
        assert not source._sending
        return viewer.complete

    assert asyncio.run(read()) == (2000,)


@pytest.mark.parametrize("closed", [True, False])
def test_a_recording_shows_the_parameters_of_its_nodes_and_what_it_can_show(tmp_path, closed):
    text = "/esc:\n  ros__parameters:\n    dwell: 2.5\n/other: 1\n/another:\n  a: 1\n"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", load_schema("std_msgs/msg/Empty"))
        bag.add_topic("/b", MessageSchema("p/msg/T", "struct T {};", "", "ros2idl"))
        if closed:
            bag.keep({"parameters": text})
    (tmp_path / "parameters.yaml").write_text("a: [" if closed else text)  # the bag's counts
    source = RecordedSource(tmp_path)
    assert source.parameters == {"/esc.dwell": 2.5}
    assert [channel.topic for channel in source.channels.values()] == ["/a"]


def test_a_record_of_parameters_that_is_none_is_refused_in_a_line(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.keep({"parameters": "a: ["})
    with pytest.raises(BagError, match="record of parameters is not valid YAML"):
        RecordedSource(tmp_path)
