"""One call of a service, made again until it is answered. No ROS, only the client's methods."""

from __future__ import annotations

import sys
import time
from typing import Any

from koop_core.stream.resend import Due, Resend

ASK_AGAIN = 1.0  # [s] without an answer


class Question:
    """One call of a service, made again every second; the service must bear that.

    A server that has not found the caller yet throws its answer away after 0.1 s
    (``rmw_send_response`` of rmw_fastrtps), and says so in a warning that the caller does not see.

    Parameters
    ----------
    client : rclpy.client.Client
        Of a service that is ready.
    request : object
        What is asked.
    """

    def __init__(self, client: Any, request: Any) -> None:
        self._client = client
        self._request = request
        self._futures: list[Any] = []
        self._due = Resend(ASK_AGAIN, sys.maxsize)
        self._due.ask(time.monotonic())
        self._call()

    def answer(self) -> Any:
        """Return the answer; None until it has come. To be called again and again."""
        if self._due.check(time.monotonic()) is Due.AGAIN:
            self._call()
        return next((future.result() for future in self._futures if future.done()), None)

    def _call(self) -> None:
        self._futures.append(self._client.call_async(self._request))
