"""The HTTP connection of our own clients: what a connection that ends under a request means, and what is sent again."""

from typing import Any

import httpx

IDLE_S = 3.0  # below every server's own limit (uvicorn's default: 5 s), so that no request meets a closing connection
IDEMPOTENT = frozenset({"GET", "HEAD", "OPTIONS", "PUT", "DELETE"})
DROPPED = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)  # not: nobody there, no answer in time


class SteadyClient(httpx.Client):
    """Sends an idempotent request once more when its connection ended under it; never another one.

    Starting a job is not among them: its Idempotency-Key makes a second one harmless, but the server answers 409 while
    the first is still being worked on, so `JobClient` pauses before it asks again.
    """

    def __init__(self, url: str, timeout_s: float, headers: dict[str, str] | None = None) -> None:
        super().__init__(base_url=url, timeout=timeout_s, headers=headers, limits=httpx.Limits(keepalive_expiry=IDLE_S))

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """As httpx.Client.send."""
        try:
            return super().send(request, **options)
        except DROPPED:
            if request.method not in IDEMPOTENT:
                raise
        return super().send(request, **options)
