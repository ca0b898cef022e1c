"""``koop serve`` over a real loop: hostile clients, another's client, a browser; the recording."""

import json
import os
import random
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from chromium import Chromium
from koop_view_running import client, heard, running, tell
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from websockets.exceptions import WebSocketException
from websockets.frames import Frame, Opcode

from koop_bag.bag.columns import read_columns
from koop_bag.bag.reader import BagReader
from koop_bringup.live.process import NodeProcess
from koop_node.process.joining import FAST_DDS
from koop_view.recorded import RecordedSource

HERE = Path(__file__).parent
GOLDEN = HERE.parents[1] / "recordings" / "golden" / "run"
NO_NETWORK = re.compile("ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ECONNRESET|ETIMEDOUT|ENETUNREACH")
FRAMES = int(os.environ.get("KOOP_FRAMES", "10000"))  # by hand: 100 000
LOST_CLIENTS = 300
TIMEOUT = 120.0  # [s]
LEVEL = "document.querySelector('#health [data-node=\"/koopman_lifter\"]')?.dataset.level"
ACT = "document.querySelector('#acts li')"


def until(condition, what):
    deadline = time.monotonic() + TIMEOUT
    while not (actual := condition()):
        assert time.monotonic() < deadline, f"timed out: {what}"
        time.sleep(0.01)
    return actual


@pytest.fixture(scope="module")
def story(module_start, tmp_path_factory, reference):
    """Live through all that a server may meet, over one loop; return what was seen."""
    folder = tmp_path_factory.mktemp("view")
    run = folder / "run"
    recorder = module_start("recorder", output=run)
    module_start("vdp_plant", pace="realtime", duration=0.0, listeners="next recorder")
    module_start("relay_esc", listeners="next recorder")
    lifter = module_start("koopman_lifter", listeners="next recorder")
    words = ["serve", "--port", "0", "--operate"]
    view = NodeProcess("view", words, folder / "view.log", [sys.executable, "-m", "koop_lab"])
    module_start.running.append(view)
    log = view.log
    actual = until(
        lambda: re.search(r"(http://127.0.0.1:(\d+)/#token=(\S+))", log.read_text()), "the server"
    )
    observed = SimpleNamespace(folder=folder, run=run, log=log, url=actual[1])
    observed.port, observed.token, observed.pid = int(actual[2]), actual[3], view.process.pid
    observed.viewer, observed.messages = viewer(observed.port)
    observed.refused = without_token(observed.port, observed.token)
    receive(observed, 30)  # theta moves
    observed.answer = hold(observed.port, observed.token, True)
    receive(observed, 100)  # theta is held
    hold(observed.port, observed.token, False)
    observed.heard = reference
    if callable(reference):
        observed.heard = reference(observed.port, state=200, cost=200, theta=200, diagnostics=3)
    observed.before = len(observed.messages)
    hostile(observed.port)
    lost_clients(observed.port)
    stop_for_a_while(observed.pid)
    receive(observed, 200)
    lose_mailboxes(observed.pid)
    observed.browser = browsed(
        observed, lifter, lambda: module_start("koopman_lifter", listeners="next recorder")
    )
    observed.viewer.close()
    assert view.poll() is None
    for process in reversed(module_start.running):
        if process is not recorder and process is not lifter:
            assert process.stop() == 0, process.last_lines()
    assert recorder.stop() == 0
    return observed


def viewer(port):
    """Return a client that looks at the loop's topics, and the list of what it has got."""
    connection = client(port, max_queue=None)
    topics = {"/state", "/cost", "/theta"}
    offered = {}
    while topics - offered.keys():
        channels = heard(connection, "advertise")["channels"]
        offered |= {item["topic"]: item["id"] for item in channels}
    pairs = [{"id": n, "channelId": offered[topic]} for n, topic in enumerate(sorted(topics))]
    tell(connection, "subscribe", subscriptions=pairs)
    return connection, []


def receive(observed, count):
    """Receive as many messages more."""
    wanted = len(observed.messages) + count
    while len(observed.messages) < wanted:
        message = observed.viewer.recv(TIMEOUT)
        if isinstance(message, bytes):
            observed.messages.append(message)


def service(connection, name):
    """Return the number of a service, None if it is not offered."""
    for _ in range(20):
        offered = {s["name"]: s["id"] for s in heard(connection, "advertiseServices")["services"]}
        if name in offered:
            return offered[name]
    raise AssertionError(f"{name} is not offered")


def called(connection, number, payload):
    """Call a service; return its answer, or why it failed."""
    connection.send(struct.pack("<BIII", 2, number, 1, 3) + b"cdr" + payload)
    while True:
        message = connection.recv(TIMEOUT)
        if isinstance(message, bytes) and message[0] == 3:
            return message[16:]
        if isinstance(message, str) and json.loads(message)["op"] == "serviceCallFailure":
            return json.loads(message)["message"]


def hold(port, token, held):
    """Hold theta, or let it go."""
    with client(port, token) as operator:
        answer = called(operator, service(operator, "/relay_esc/hold"), b"\0\1\0\0" + bytes([held]))
        assert isinstance(answer, bytes), answer
        return answer


def without_token(port, token):
    """Call every service without the right; return the names with the answers."""
    with client(port, token) as operator:
        service(operator, "/relay_esc/hold")
    with client(port, token) as operator:  # which is offered all of them at once
        offered = heard(operator, "advertiseServices")["services"]
    with client(port) as reader:
        return {item["name"]: called(reader, item["id"], b"\0\1\0\0\1") for item in offered}


def hostile(port):
    """Send damaged messages, and frames that are none."""
    draw = random.Random(1)
    seeds = [
        json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]}).encode(),
        json.dumps({"op": "setParameters", "parameters": [{"name": "/a.b", "value": 1}]}).encode(),
        json.dumps({"op": "getParameters", "parameterNames": []}).encode(),
        b"[" * 5000,
        struct.pack("<BIII", 2, 9, 1, 3) + b"cdr\0\1\0\0\xff\xff\xff\xff",
        struct.pack("<BIII", 2, 9, 1, 0xFFFFFFFF) + b"cdr",
        b"\1\0\0\0\0",
        b"",
    ]

    def frame():
        data = bytearray(draw.choice(seeds))
        for _ in range(draw.randrange(3) if data else 0):
            data[draw.randrange(len(data)) : draw.randrange(len(data) + 1)] = draw.randbytes(3)
            data = data or bytearray(b"x")
        kind = Opcode.BINARY if draw.random() < 0.4 else Opcode.TEXT
        if kind is Opcode.TEXT:  # what is not UTF-8 ends a connection at once
            data = bytearray(data.decode("utf-8", "replace").encode())
        return Frame(kind, bytes(data)).serialize(mask=True)

    blobs = [b"".join(frame() for _ in range(1000)) for _ in range(10)]
    for number in range(FRAMES // 1000):
        blob = bytearray(blobs[number % len(blobs)])
        if number % 10 == 0:  # no frames at all
            for _ in range(100):
                blob[draw.randrange(len(blob))] = draw.randrange(256)
        mute = client(port, max_queue=None, close_timeout=1.0)
        with suppress(OSError, WebSocketException), mute as connection:
            connection.socket.sendall(blob)


def stop_for_a_while(process):
    """Stop a process for longer than Fast DDS takes a mailbox in shared memory for healthy."""
    os.kill(process, signal.SIGSTOP)
    time.sleep(1.5)  # beside a loop at full rate
    os.kill(process, signal.SIGCONT)


def lose_mailboxes(process):
    """Do away with the mailboxes in shared memory that a process has, as Fast DDS may under load.

    Who has one open writes to it still; who comes later makes another, at which nobody listens.
    """
    for descriptor in Path(f"/proc/{process}/fd").iterdir():
        link = ""
        with suppress(FileNotFoundError):  # closed by now
            link = os.readlink(descriptor)
        if re.fullmatch(rf"/dev/shm/{FAST_DDS}_port\d+_el", link):  # the lock of who listens there
            Path(link.removesuffix("_el")).unlink(missing_ok=True)


def lost_clients(port):
    """Connect, say half a sentence or nothing, and stay."""
    several = []
    for number in range(LOST_CLIENTS):
        with suppress(OSError):
            connection = socket.create_connection(("127.0.0.1", port), 1.0)
            connection.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" * (number % 2))
            several.append(connection)
    for connection in several:
        connection.close()


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return a function that runs the reference client, or why it could not be had."""
    if not (shutil.which("node") and shutil.which("npm")):
        return "the reference client needs Node.js and npm, which are not installed"
    folder = tmp_path_factory.mktemp("foxglove")
    for name in ("package.json", "listen.mjs"):
        shutil.copy(HERE / "foxglove" / name, folder)
    install = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock", "--ignore-scripts",
               "--prefer-offline"]  # fmt: skip
    done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode and NO_NETWORK.search(done.stderr):
        return "npm could not install the reference client: there is no network"
    assert done.returncode == 0, done.stderr

    def listen(port, **wanted):
        counts = {f"/{topic.replace('__', '/')}": count for topic, count in wanted.items()}
        command = ["node", "listen.mjs", f"ws://127.0.0.1:{port}/", json.dumps(counts)]
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=True, timeout=TIMEOUT
        )
        by_topic = {}
        for line in done.stdout.splitlines():
            item = json.loads(line, parse_int=float)  # 1e17 is written without a point
            by_topic.setdefault(item["topic"], []).append(item["message"])
        return by_topic

    return listen


def decoded(bag, topic):
    """Return a topic's messages as `rosbags` reads them."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        messages = reader.messages(connections)
        return [plain(reader.deserialize(raw, c.msgtype)) for c, _, raw in messages]


def browsed(observed, lifter, restart):
    """Look at the loop in a browser, hold it, kill and restart its lifter."""
    try:
        browser = Chromium(observed.folder, observed.url)
    except pytest.skip.Exception as missing:
        return str(missing)
    with browser as page:
        page.wait(f"{LEVEL} == 'ok'")
        page.wait("(koop.raw('r')?.v.length ?? 0) > 300")
        drawn = {name: page.value(f"koop.raw('{name}')") for name in ("r", "theta")}
        clicked = page.value("document.querySelector('#hold').click(), Date.now()")
        page.wait(f"{ACT}?.dataset.outcome == 'done'")
        page.value(
            "document.querySelector('#theta-min').value = '50';"
            "document.querySelector('#theta-min').dispatchEvent(new Event('input'));"
            "document.querySelector('#set-limits').click()"
        )
        page.wait("document.querySelector('#confirm').open")
        page.value("document.querySelector('#confirm-yes').click()")
        page.wait(f"{ACT}.dataset.outcome == 'refused'")
        reason = page.value(f"{ACT}.textContent")
        lifter.process.kill()
        begin = time.monotonic()
        page.wait(f"{LEVEL} == 'stale'")
        stale = time.monotonic() - begin
        restart()
        page.wait(f"{LEVEL} == 'ok'")
        result = SimpleNamespace(
            drawn=drawn, clicked=clicked, reason=reason, stale=stale, errors=page.errors
        )
    lifter.process.wait()
    return result


@pytest.fixture(scope="module")
def bag(story):
    """Return the recording's columns of the loop, by topic."""
    wanted = {"/state": ["step"], "/ground_truth": ["step"], "/cost": ["step", "r"],
              "/theta": ["step", "theta[0]", "holding", "log_time"]}  # fmt: skip
    with BagReader(story.run) as reader:
        return {name: read_columns(reader, name, options) for name, options in wanted.items()}


def test_nothing_of_the_loop_was_lost_to_hostile_and_to_lost_clients(story, bag):
    for topic in ("/state", "/ground_truth"):
        assert set(np.diff(bag[topic]["step"])) == {1}, topic
    killed = np.flatnonzero(np.diff(bag["/cost"]["step"]) != 1)
    whole = bag["/cost"]["step"][: killed[0] + 1] if killed.size else []
    if isinstance(story.browser, str):
        assert not killed.size
    else:  # the browser's tale ends with the death of the lifter
        assert set(np.diff(whole)) == {1}
    assert "Traceback" not in story.log.read_text()
    assert len(story.messages) >= 200  # and who looked on all the while went on seeing


def test_who_has_no_token_is_refused_every_service_that_moves_the_rig(story):
    moving = ("hold", "reset", "set_parameters_atomically")
    assert {f"/relay_esc/{name}" for name in moving} <= story.refused.keys()
    assert all("may only read" in answer for answer in story.refused.values())


def test_an_act_of_operating_is_in_the_recording_and_in_the_log(story, bag):
    assert b"theta held at" in story.answer
    held = bag["/theta"]["holding"].astype(bool)
    assert held.any()
    assert not held[0]
    with AnyReader(
        [story.run / "bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)
    ) as reader:
        rosout = [c for c in reader.connections if c.topic == "/rosout"]
        said = [reader.deserialize(raw, c.msgtype).msg for c, _, raw in reader.messages(rosout)]
    acts = [text for text in said if "operates: /relay_esc/hold(data=True): success=True" in text]
    assert acts
    assert acts[0] in story.log.read_text()
    assert any("may only read: a call takes the token" in text for text in said)


def test_a_client_of_others_reads_all_channels_as_they_were_recorded(story):
    if isinstance(story.heard, str):
        pytest.skip(story.heard)
    assert {"/state", "/cost", "/theta", "/ground_truth", "/diagnostics"} <= story.heard.keys()
    for topic, actual in story.heard.items():
        recorded = decoded(story.run / "bag", topic)
        assert [message for message in actual if message not in recorded] == [], topic
    ahead = [message["step"] for message in story.heard["/cost"]]
    assert ahead == sorted(set(ahead))


def test_a_client_of_others_reads_a_recorded_run_whole(reference):
    if isinstance(reference, str):
        pytest.skip(reference)
    with BagReader(GOLDEN) as bag:
        counts = {topic.name: topic.count for topic in bag.topics if topic.count}
    with running(RecordedSource(GOLDEN)) as port:
        actual = reference(port, **{name[1:].replace("/", "__"): n for name, n in counts.items()})
    assert actual == {name: decoded(GOLDEN / "bag", name) for name in counts}


def plain(value):
    """Return a message of `rosbags` as the other client prints it."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    if is_dataclass(value):  # whose constants are fields, too
        names = [item.name for item in fields(value) if item.name.islower()]
        return {name: plain(getattr(value, name)) for name in names if name != "__msgtype__"}
    return value


def test_what_the_page_draws_is_what_was_recorded(story, bag):
    drawn = browser_of(story).drawn
    for name, topic, field in (("r", "/cost", "r"), ("theta", "/theta", "theta[0]")):
        recorded = dict(zip(bag[topic]["step"].tolist(), bag[topic][field].tolist(), strict=True))
        steps = drawn[name]["step"]
        assert steps == sorted(set(steps)), name
        assert [recorded[step] for step in steps] == drawn[name]["v"], name
        # a server without a processor misses messages, which delays nobody else
        assert len(steps) > 0.5 * (steps[-1] - steps[0] + 1), name


def test_a_click_holds_theta_and_a_refusal_says_why(story, bag):
    page = browser_of(story)
    held = bag["/theta"]["holding"].astype(bool)
    since = bag["/theta"]["log_time"][held] * 1e-6 - page.clicked
    assert (since > 0).any()
    print(f"theta held {since[since > 0].min():.0f} ms after the click")
    assert "theta_min" in page.reason


def test_a_dead_lifter_shows_and_recovers_and_the_console_is_silent(story):
    page = browser_of(story)
    print(f"stale {page.stale:.1f} s after the lifter was killed")
    assert page.errors == []


def browser_of(story):
    """Return what was seen in the browser."""
    if isinstance(story.browser, str):
        pytest.skip(story.browser)
    return story.browser
