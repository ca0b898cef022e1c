"""The page in real Chromium: a long run that is fed fast, a fleet, a server that is restarted."""

import asyncio
import threading
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
from chromium import Chromium
from koop_view_running import running
from rosbags.typesys import Stores, get_typestore
from websockets.exceptions import ConnectionClosed

from koop_bag.bag.reader import BagReader
from koop_bag.cdr.schema import load_schema, load_service
from koop_view.protocol import AdvertisedChannel, AdvertisedService
from koop_view.recorded import RecordedSource
from koop_view.roles import LoopNames
from koop_view.session import ViewSource

GOLDEN = Path(__file__).parents[2] / "recordings" / "golden" / "run"
PERIOD = 50_000_000  # [ns] between two steps: a run of hours in seconds
EARLY, ALL = 18_000, 32_000  # steps
LONG = 120.0  # [s] that a busy machine may take
BEGIN = 10**9  # [s]
GROWTH = 1_000_000  # [B], 24 for each message between the two looks
WIDTHS = 320, 390, 768, 1400  # [px]
NEWEST = "(window.koop?.newest() ?? 0)"
OUTSIDE = """[...document.querySelectorAll('body *')].filter((element) => {
  const { left, right, width } = element.getBoundingClientRect();
  return width && (right > innerWidth + 1 || left < -1);
}).map((element) => element.outerHTML.slice(0, 80))"""
FITS = """[...document.querySelectorAll('.uplot')].every(
  (plot) => Math.abs(plot.clientWidth - plot.parentNode.clientWidth) < 2)"""
TRIES = """(address => {
  const socket = new WebSocket(address, ["foxglove.sdk.v1"]);
  window.told = "";
  socket.onopen = () => (window.told = "open");
  socket.onerror = () => (window.told = "refused");
})"""


class Long(RecordedSource):
    """The golden bag over and over, as a loop that runs: restarted every 2000 steps.

    It goes on where it was, should a busy machine cost the page its connection.
    """

    mode = "live"
    _sent = 0

    async def _send(self, viewer, wanted):
        numbers = {channel.topic: number for number, channel in wanted.items()}
        topics = sorted({"/state", "/cost", "/theta"} & numbers.keys())
        with BagReader(GOLDEN) as bag:
            messages = [(m.topic, m.data) for m in bag.messages(topics)]
        with suppress(ConnectionClosed):
            while self._sent < 3 * ALL:
                topic, data = messages[self._sent % len(messages)]
                time = BEGIN * 10**9 + self._sent // 3 * PERIOD
                await viewer.deliver_slowly(numbers[topic], time, data)
                self._sent += 1
                if self._sent % 60 == 0:
                    await asyncio.sleep(0)


TOKENS = "the-first-token", "the-second-token"
MODE = "document.querySelector('#mode')?.textContent"
KIND = "diagnostic_msgs/msg/DiagnosticArray"
SERVICE = "rcl_interfaces/srv/SetParametersAtomically"


class Fleet(ViewSource):
    """Three loops whose lifters report; that of the second one is broken, of the third silent.

    That of the first one proposes a model.
    """

    mode = "live"

    def __init__(self):
        super().__init__()
        self.about = "commissioning: tune, round 1"
        self.loops = {name: LoopNames(name, lifter=f"{name}/lifter") for name in ("/a", "/b", "/c")}
        self.channels = {1: AdvertisedChannel(1, "/diagnostics", KIND, load_schema(KIND).text)}
        name = "/a/lifter/set_parameters_atomically"
        self.services = {1: AdvertisedService(1, name, SERVICE, *load_service(SERVICE))}
        self.calls = []
        self._tasks = set()

    async def call(self, service, payload, peer):
        from rcl_interfaces.srv import SetParametersAtomically as Service
        from rclpy.serialization import deserialize_message, serialize_message

        (parameter,) = deserialize_message(payload, Service.Request).parameters
        self.calls.append((parameter.name, parameter.value.string_value))
        answer = Service.Response()
        answer.result.successful = True
        return bytes(serialize_message(answer))

    def subscribe(self, viewer, wanted):
        self._tasks.add(asyncio.get_running_loop().create_task(self._report(viewer, *wanted)))

    def unsubscribe(self, viewer, subscription, channel):
        for task in self._tasks:
            task.cancel()

    async def _report(self, viewer, subscription):
        store = get_typestore(Stores.ROS2_JAZZY)
        status_of = store.types["diagnostic_msgs/msg/DiagnosticStatus"]
        header = store.types["std_msgs/msg/Header"](
            store.types["builtin_interfaces/msg/Time"](0, 0), ""
        )
        proposed = store.types["diagnostic_msgs/msg/KeyValue"]("proposed_model", "better.npz")
        silent = iter(["/c"])
        while True:
            status = [
                status_of(
                    level, f"{name}/lifter", "words", f"koop{name}", [proposed] * (name == "/a")
                )
                for name, level in [("/a", 0), ("/b", 2), *((name, 0) for name in silent)]
            ]
            message = store.types[KIND](header, status)
            viewer.deliver(subscription, 10**18, bytes(store.serialize_cdr(message, KIND)))
            await asyncio.sleep(0.2)


@pytest.fixture(scope="module")
def observed(tmp_path_factory):
    """Let the run pass by on a desk, then look at it on a phone; return what was seen."""
    folder = tmp_path_factory.mktemp("page")
    with running(Long(GOLDEN)) as port, Chromium(folder, f"http://127.0.0.1:{port}/") as page:
        page.wait(f"{NEWEST} >= {BEGIN + (EARLY - 1) * PERIOD * 1e-9}", LONG)
        early = page.memory(), page.value("document.querySelectorAll('*').length")
        page.wait(f"{NEWEST} >= {BEGIN + (ALL - 1) * PERIOD * 1e-9}", LONG)
        late = page.memory(), page.value("document.querySelectorAll('*').length")
        widths = {}
        for width in WIDTHS:
            page.resize(width, 850)
            page.wait(f"{FITS} && document.documentElement.scrollWidth <= {width}")
            widths[width] = page.value(OUTSIDE)
        errors = list(page.errors)
        lines = [told_by(page, port)]
        with (
            another_server() as other
        ):  # on this machine too: of a page from afar browsers see to it
            page.open(f"http://127.0.0.1:{other}/")
            page.wait(f"location.port == '{other}' && document.readyState == 'complete'")
            lines.append(told_by(page, port))
        return SimpleNamespace(early=early, late=late, widths=widths, errors=errors, told=lines)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Look at a fleet, restart its server, open the new address in the old tab."""
    folder = tmp_path_factory.mktemp("fleet")
    with Chromium(folder, "about:blank") as page:
        with running(source := Fleet(), TOKENS[0]) as port:
            page.open(f"http://127.0.0.1:{port}/#token={TOKENS[0]}")
            page.wait("document.querySelector('#fleet')?.textContent.includes('/c')")
            page.wait("document.querySelector('#use-model').disabled === false")
            proposal = page.value("document.querySelector('#proposal').innerText")
            page.value("document.querySelector('#use-model').click()")
            page.value("document.querySelector('#confirm-yes').click()")
            acts = page.wait(
                "document.querySelector('#acts').textContent.includes('done') && "
                "document.querySelector('#acts').textContent"
            )
            bad = page.value("document.querySelector('#fleet').textContent")
            loops = page.value("[...document.querySelectorAll('#loop option')].map(o => o.text)")
            page.value("document.querySelector('#loop').value = '/b'")
            page.value("document.querySelector('#loop').dispatchEvent(new Event('change'))")
            page.wait("document.querySelector('#verdict').textContent.startsWith('Fault: lifter')")
            page.wait("document.querySelector('#proposal').hidden")
            about = page.value("document.querySelector('#about').textContent")
            modes = [page.value(MODE)]
        with running(Fleet(), TOKENS[1], port=port):
            page.wait(f"{MODE} == 'read-only'")
            notes = page.wait("document.querySelector('#notes').textContent")
            page.value(f"location.hash = 'token={TOKENS[1]}'")
            modes.append(page.wait(f"{MODE} == 'operating' && {MODE}"))
        return SimpleNamespace(
            loops=loops, bad=bad, about=about, modes=modes, notes=notes, proposal=proposal,
            acts=acts, calls=source.calls,
        )  # fmt: skip


def told_by(page, port):
    """Let the page connect; return what came of it."""
    page.value(f"{TRIES}('ws://127.0.0.1:{port}/')")
    return page.wait("window.told")


@contextmanager
def another_server():
    """Serve nothing but an error message; give the port."""
    with HTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


def test_memory_stays_flat_however_long_the_run(observed):
    print(f"{observed.early[0]} B after {EARLY} steps, {observed.late[0]} B after {ALL}")
    assert observed.late[0] - observed.early[0] < GROWTH
    assert abs(observed.late[1] - observed.early[1]) < 50  # elements


def test_no_width_needs_to_be_scrolled_sideways(observed):
    assert not any(observed.widths.values()), observed.widths


def test_a_page_of_another_server_is_refused(observed):
    assert observed.told == ["open", "refused"]


def test_the_selector_says_which_loop_of_a_fleet_is_bad(fleet):
    assert "/a: OK" in fleet.loops
    assert fleet.bad == "/b: ERROR, /c: STALE"
    assert fleet.about == "commissioning: tune, round 1"


def test_a_proposed_model_is_taken_by_a_button(fleet):
    assert "a better model: better.npz" in fleet.proposal
    assert fleet.calls == [("model", "better.npz")]
    assert fleet.acts.startswith("use the new model – done")


def test_a_page_follows_a_restarted_server_which_has_another_token(fleet):
    assert fleet.modes == ["operating", "operating"]
    assert "token is not this server's" in fleet.notes


def test_the_console_is_silent(observed):
    assert observed.errors == []
