"""HTTP connection of our clients: classification of connection failures, and retries."""

import urllib.request
from typing import Any
from urllib.parse import urlsplit

import httpx

from server.access.hosts import is_loopback

IDLE_S = 3.0  # below every server's own limit (uvicorn's default: 5 s), so that no request meets a closing connection
IDEMPOTENT = frozenset({"GET", "HEAD", "OPTIONS", "PUT", "DELETE"})
DROPPED = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)  # not: connection refused, timeout


class SteadyClient(httpx.Client):
    """Sends an idempotent request once more when its connection ended under it; never another one.

    Starting a job is not among them: its Idempotency-Key makes a second one harmless, but the server answers 409 while
    the first is still being worked on, so `JobClient` pauses before it asks again.
    """

    def __init__(self, url: str, timeout_s: float, headers: dict[str, str] | None = None) -> None:
        host = _host(url)
        direct = (
            {f"all://[{host}]" if ":" in host else f"all://{host}": None} if is_loopback(host) else None
        )  # this computer itself is not behind a proxy
        limits = httpx.Limits(keepalive_expiry=IDLE_S)
        super().__init__(base_url=url, timeout=timeout_s, headers=headers, limits=limits, mounts=direct)

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """As httpx.Client.send."""
        try:
            return super().send(request, **options)
        except DROPPED:
            if request.method not in IDEMPOTENT:
                raise
        return super().send(request, **options)


def reason_in(answer: httpx.Response) -> str:
    """Why a request failed: the server's own words, or that something else answered in its place."""
    try:
        problem = answer.json()
        return "; ".join(problem.get("reasons") or filter(None, (problem["detail"], problem.get("hint", ""))))
    except (ValueError, KeyError, AttributeError):
        url = str(answer.request.url)
        return (
            f"{url} answers {answer.status_code} {answer.reason_phrase}, which is not a longreach answer{by_proxy(url)}"
        )


def by_proxy(url: str) -> str:
    """Note for messages that a request goes through a proxy of the environment; empty for a direct request."""
    host, scheme = _host(url), urlsplit(url).scheme
    proxies = urllib.request.getproxies()
    proxy = proxies.get(scheme, proxies.get("all", ""))
    if not proxy or not host or is_loopback(host) or urllib.request.proxy_bypass(host):
        return ""
    return f"; the request went through the proxy {proxy} ({scheme}_proxy); add {host} to no_proxy to connect directly"


def _host(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""
