"""A recorded run as a source. No ROS."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed

from koop_bag.bag.playback import in_time_order
from koop_bag.bag.reader import BagReader
from koop_bag.errors import BagError
from koop_view.protocol import ENCODING, ERROR, INFO, SCHEMA_ENCODING, AdvertisedChannel
from koop_view.roles import LoopNames, find_loops, namespace_of
from koop_view.session import ClientSession, ViewSource

COMPLETE = "recording complete"
TURN = 200  # messages after which other clients have their turn


class RecordedSource(ViewSource):
    """The topics of a bag, from the first message to the last as fast as a client takes them.

    Parameters
    ----------
    path : path
        A run folder, a bag folder or an ``.mcap`` file.

    Raises
    ------
    BagError
        If there is no bag, or it is damaged.
    """

    mode = "recorded"

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        self._path = path
        self._tasks: set[asyncio.Task[None]] = set()
        self._sending: Counter[ClientSession] = Counter()
        with BagReader(path) as bag:
            topics = [
                item
                for item in bag.topics
                if (item.encoding, item.language) == (ENCODING, SCHEMA_ENCODING)
            ]
            for node, values in bag.parameters.items():
                self.parameters |= {f"{node}.{name}": value for name, value in values.items()}
        for number, item in enumerate(topics, 1):
            self.channels[number] = AdvertisedChannel(
                number, item.name, item.type_name, item.definition
            )
        self.loops = _loops({t.name: t.type_name for t in topics}, self.parameters)

    def subscribe(self, viewer: ClientSession, wanted: Mapping[int, AdvertisedChannel]) -> None:
        """Send channels that are subscribed to together in time order."""
        self._sending[viewer] += 1
        task = asyncio.get_running_loop().create_task(self._send(viewer, wanted))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send(self, viewer: ClientSession, wanted: Mapping[int, AdvertisedChannel]) -> None:
        """Send channels as long as they are subscribed to, and say when all of a client's are."""
        numbers = {channel.topic: number for number, channel in wanted.items()}
        try:
            with BagReader(self._path) as bag:
                for count, message in enumerate(in_time_order(bag.messages(list(numbers)))):
                    number = numbers.get(message.topic)
                    if number is None:
                        continue
                    if not await viewer.deliver_slowly(number, message.log_time, message.data):
                        del numbers[message.topic]
                    if not numbers:
                        return
                    if count % TURN == 0:
                        await asyncio.sleep(0)
            if self._sending[viewer] == 1:
                viewer.say(INFO, COMPLETE)
        except BagError as error:
            viewer.say(ERROR, str(error))
        except ConnectionClosed:
            pass
        finally:
            self._sending[viewer] -= 1
            self._sending += Counter()  # keeps no client that has none


def _loops(topics: Mapping[str, str], parameters: Mapping[str, Any]) -> dict[str, LoopNames]:
    """Return the loops as far as names and parameters show: a bag does not name publishers.

    The nodes are recognised by parameters that only they have. A theta alone is not a loop: a
    controller published it while another one commanded the rig.
    """
    roles = {"omega_h": "lifter", "dwell": "controller", "theta_star": "plant"}
    loops = {
        space: loop for space, loop in find_loops({}, topics).items() if loop.state or loop.cost
    }
    for full in parameters:
        node, _, name = full.partition(".")
        space = namespace_of(node)
        if name in roles and space in loops:
            loops[space] = replace(loops[space], **{roles[name]: node})
    return loops
