"""Moves without pause, as jobs over REST from a thread: back from the wall, folded, back again."""

import contextlib
import itertools
import threading
from typing import Any, Self

import httpx

from longreach.fleet_client import JobClient, JobRefusedError

BODIES: tuple[dict[str, Any], ...] = ({"kind": "retract", "distance_mm": 300.0}, {"kind": "park", "wall_free": True})
_PAUSE_S = 0.5


class Mover:
    """A context manager: inside it the machine is at work. `ended` counts jobs by kind and end."""

    def __init__(self, url: str) -> None:
        self._client = JobClient(url, owner="load bench")
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._work, name="mover", daemon=True)
        self.ended: dict[str, int] = {}

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._done.set()
        with contextlib.suppress(httpx.HTTPError):  # a server that is gone moves nothing
            self._client.stop()
        self._thread.join(30.0)
        self._client.close()

    def taken(self) -> dict[str, int]:
        """What ended since the last call."""
        ended, self.ended = self.ended, {}
        return ended

    def _work(self) -> None:
        for body in itertools.cycle(BODIES):
            if self._done.is_set():
                return
            told = self._one(body)
            self.ended[told] = self.ended.get(told, 0) + 1

    def _one(self, body: dict[str, Any]) -> str:
        try:
            end = self._client.run(body)
        except (JobRefusedError, httpx.HTTPError) as error:
            self._done.wait(_PAUSE_S)
            return f"{body['kind']} refused: {str(error)[:80]}"
        if end.state != "done":
            self._done.wait(_PAUSE_S)
        return f"{body['kind']} {end.state}" + (f": {end.reason[:80]}" if end.state == "failed" else "")
