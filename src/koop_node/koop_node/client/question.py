"""One call of a service, made again until it is answered. No ROS, only the client's methods."""

from __future__ import annotations

import time
from typing import Any

ASK_AGAIN = 1.0  # [s] without an answer


class Question:
    """One call of a service, made again every second; the service must bear that.

    A server that has not found the caller yet throws its answer away after 0.1 s
    (``rmw_send_response`` of rmw_fastrtps), and says so in a warning that the caller does not see.
    The client is one of a service that is ready.
    """

    def __init__(self, client: Any, request: Any) -> None:
        self._client, self._request = client, request
        self._futures: list[Any] = []
        self._call()

    def answer(self) -> Any:
        """Return the answer; None until it has come. To be called again and again."""
        if time.monotonic() - self._asked >= ASK_AGAIN:
            self._call()
        return next((future.result() for future in self._futures if future.done()), None)

    def _call(self) -> None:
        self._asked = time.monotonic()
        self._futures.append(self._client.call_async(self._request))
