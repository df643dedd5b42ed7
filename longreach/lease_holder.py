"""Holding control of one server: acquire, keep alive from a thread, give back."""

import threading
from typing import Any, Self

import httpx

from longreach.fleet_connection import reason_in

TTL_S = 15.0  # a client that dies without a word (SIGKILL, a power cut) moves its machine for so long at most


class ControlRefusedError(Exception):
    """The server refused control; the text is the server's own."""


class LeaseHolder:
    """A context manager: inside it this program has control, and `headers` prove it."""

    def __init__(self, http: httpx.Client, owner: str, kind: str, ttl_s: float = TTL_S) -> None:
        self._http, self._owner, self._kind, self._ttl_s = http, owner, kind, ttl_s
        self._lease: dict[str, Any] = {}
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        """Acquire.

        Raises: ControlRefusedError: another client has control.
        """
        answer = self._http.post("/v1/lease", json={"owner": self._owner, "kind": self._kind, "ttl_s": self._ttl_s})
        if answer.status_code != httpx.codes.CREATED:
            raise ControlRefusedError(reason_in(answer))
        self._lease = answer.json()
        self._done.clear()
        self._thread = threading.Thread(target=self._keep_alive, name="lease", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._done.set()
        if self._thread is not None:
            self._thread.join(self._ttl_s)
        try:
            self._http.delete(f"/v1/lease/{self._lease['lease_id']}")
        except httpx.TransportError:
            return  # a server that is gone keeps no lease

    @property
    def headers(self) -> dict[str, str]:
        """What every command that can move or arm carries."""
        return {"Longreach-Lease": self._lease["lease_id"], "Longreach-Fencing": str(self._lease["fencing"])}

    def _keep_alive(self) -> None:
        while not self._done.wait(self._ttl_s / 3.0):
            try:
                answer = self._http.put(f"/v1/lease/{self._lease['lease_id']}")
            except httpx.TransportError:
                continue  # the next one may pass; else it goes stale, as it should
            if answer.status_code in (httpx.codes.FORBIDDEN, httpx.codes.CONFLICT):
                return  # another client has control: the next command is refused and says who
