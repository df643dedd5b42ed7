"""The state as JSON text, made at most 20 times a second however many ask."""

import time
from collections.abc import Callable

from server.api.state_view import state_view
from server.jobs.service import JobService

FRESH_S = 0.05


class StateCache:
    """Belongs to the event loop."""

    def __init__(self, service: JobService, clock: Callable[[], float] = time.monotonic) -> None:
        self._service, self._clock = service, clock
        self._text, self._made_s = "", float("-inf")

    def text(self) -> str:
        """Not older than FRESH_S."""
        now_s = self._clock()
        if now_s - self._made_s > FRESH_S:
            service = self._service
            self._text = state_view(service.cell, service.engine, service.context).model_dump_json()
            self._made_s = now_s
        return self._text
