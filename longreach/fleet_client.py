"""Small REST client for jobs, used by `position`, the benches and fleet programs."""

import json
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit
from uuid import uuid4

import httpx

from longreach.signals import ended_as_by_ctrl_c
from recording.files import read_text
from server.access.hosts import is_loopback
from server.errors import SettingsError

# HTTP connection of our clients: classification of connection failures, and retries.

# Below every server's own limit (uvicorn's default: 5 s), so that no request meets a closing connection
KEEPALIVE_EXPIRY_S = 3.0
IDEMPOTENT_HTTP_METHODS = frozenset({"GET", "HEAD", "OPTIONS", "PUT", "DELETE"})
DROPPED_CONNECTION_ERRORS = (
    httpx.RemoteProtocolError,
    httpx.ReadError,
    httpx.WriteError,
)  # not: connection refused, timeout


class SteadyClient(httpx.Client):
    """Sends an idempotent request once more when its connection ended under it; never another one.

    Starting a job is not among them: its Idempotency-Key makes a second one harmless, but the server answers 409 while
    the first is still being worked on, so `JobClient` pauses before it asks again.
    """

    def __init__(self, url: str, timeout_s: float, headers: dict[str, str] | None = None) -> None:
        host = _host_of_url(url)
        direct = (
            {f"all://[{host}]" if ":" in host else f"all://{host}": None} if is_loopback(host) else None
        )  # this computer itself is not behind a proxy
        limits = httpx.Limits(keepalive_expiry=KEEPALIVE_EXPIRY_S)
        super().__init__(base_url=url, timeout=timeout_s, headers=headers, limits=limits, mounts=direct)

    def send(self, request: httpx.Request, **options: Any) -> httpx.Response:
        """As httpx.Client.send."""
        try:
            return super().send(request, **options)
        except DROPPED_CONNECTION_ERRORS:
            if request.method not in IDEMPOTENT_HTTP_METHODS:
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
    host, scheme = _host_of_url(url), urlsplit(url).scheme
    proxies = urllib.request.getproxies()
    proxy = proxies.get(scheme, proxies.get("all", ""))
    if not proxy or not host or is_loopback(host) or urllib.request.proxy_bypass(host):
        return ""
    return f"; the request went through the proxy {proxy} ({scheme}_proxy); add {host} to no_proxy to connect directly"


def _host_of_url(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


RETRIES = 3
RETRY_DELAY_S = 0.5


# Holding control of one server: acquire, keep alive from a thread, give back.

LEASE_TTL_S = 15.0  # a client that dies without a word (SIGKILL, a power cut) moves its machine for so long at most


class ControlRefusedError(Exception):
    """The server refused control; the text is the server's own."""


class LeaseHolder:
    """A context manager: inside it this program has control, and `headers` prove it."""

    def __init__(self, http: httpx.Client, owner: str, kind: str, ttl_s: float = LEASE_TTL_S) -> None:
        self._http, self._owner, self._kind, self._ttl_s = http, owner, kind, ttl_s
        self._lease: dict[str, Any] = {}
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        """Acquire. Raises: ControlRefusedError: another client has control."""
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


class JobRefusedError(Exception):
    """The server refused a request; the text is the server's own."""


@dataclass(frozen=True, slots=True)
class Finished:
    """A job at its end."""

    state: str
    reason: str
    result: Any
    elapsed_s: float
    job_id: str = ""


def read_key(path: Path | None) -> str:
    """The key in a file; empty without one. Raises: SettingsError: the file cannot be read."""
    try:
        return read_text(path).strip() if path is not None else ""
    except OSError as error:
        raise SettingsError(f"key file {path}: {error.strerror}") from error


class JobClient:
    """Starts jobs on one server and follows them to their end, each under control of its own."""

    def __init__(
        self, url: str, timeout_s: float = 10.0, *, owner: str = "longreach", kind: str = "operator", key: str = ""
    ) -> None:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        self._http = SteadyClient(url, timeout_s, headers)
        self._owner, self._kind = owner, kind
        self._abandoned, self._running = threading.Event(), False

    @property
    def url(self) -> str:
        """The server's address."""
        return str(self._http.base_url)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def wait_ready(self, timeout_s: float, report: Callable[[float, str], None] = lambda _s, _why: None) -> None:
        """Wait until a job could start; `report` gets the waiting time [s] and the reason, and may raise.

        Raises: JobRefusedError with the server's last reasons when that takes longer.
        """
        began, reasons = time.monotonic(), "server does not answer"
        while (waited_s := time.monotonic() - began) < timeout_s:
            self._refuse_if_abandoned()
            report(waited_s, reasons)
            try:
                answer = self._http.get("/readyz")
                if answer.status_code == 200:
                    return
                reasons = reason_in(answer)
            except httpx.UnsupportedProtocol as error:
                raise JobRefusedError(
                    f"'{self._http.base_url}' is not an address; give one such as http://127.0.0.1:8080"
                ) from error
            except httpx.TransportError as error:
                reasons = f"server does not answer ({error}){by_proxy(self.url)}"
            self._abandoned.wait(0.2)
        raise JobRefusedError(f"not ready after {timeout_s:.0f} s: {reasons}")

    def state(self) -> dict[str, Any]:
        """The state view."""
        return self._http.get("/v1/state").raise_for_status().json()

    def get(self, path: str) -> Any:
        """The JSON of a path. Raises: JobRefusedError: the server refuses, with its reason."""
        return self._raise_unless_success(self._http.get(path)).json()

    def get_text(self, path: str) -> str:
        """The text of a path. Raises: JobRefusedError: the server refuses, with its reason."""
        return self._raise_unless_success(self._http.get(path)).text

    def send(self, method: str, path: str, body: dict[str, Any]) -> Any:
        """Send a command other than a job, under control of its own; its answer.

        Raises: JobRefusedError: control is not given, or the server refuses, with its reason.
        """
        try:
            with ended_as_by_ctrl_c(), LeaseHolder(self._http, self._owner, self._kind) as held:
                return self._raise_unless_success(
                    self._http.request(method, path, json=body, headers=held.headers)
                ).json()
        except ControlRefusedError as error:
            raise JobRefusedError(str(error)) from error

    def _raise_unless_success(self, answer: httpx.Response) -> httpx.Response:
        if answer.is_success:
            return answer
        raise JobRefusedError(reason_in(answer))

    def stop(self) -> None:
        """Stop motion (software); repeated when the connection broke, since a second stop is harmless."""
        try:
            answer = self._http.post("/v1/stop")
        except httpx.TransportError:
            answer = self._http.post("/v1/stop")
        answer.raise_for_status()

    def run(self, body: dict[str, Any], on_event: Callable[[dict[str, Any]], None] | None = None) -> Finished:
        """Acquire control, start a job, follow it to its end, release. Whatever ends this early stops the machine.

        In the main thread SIGTERM and SIGHUP meanwhile raise KeyboardInterrupt, unless the program handles them itself.

        Raises: JobRefusedError when control is not given or the server does not start it.
        """
        try:
            owner = body.get("owner", self._owner)
            with ended_as_by_ctrl_c(), LeaseHolder(self._http, owner, self._kind) as held:
                return self._run(body, held.headers, on_event)
        except ControlRefusedError as error:
            raise JobRefusedError(str(error)) from error

    def run_id_of(self, job_id: str) -> str:
        """The run that a job was recorded as; empty where it was not, or the server no longer answers."""
        try:
            listed = self._http.get("/v1/runs", params={"limit": 10}).raise_for_status().json()
        except (httpx.HTTPError, ValueError):
            return ""
        return next((run["run_id"] for run in listed if run["run_id"].endswith(f"-{job_id}")), "")

    def _run(
        self, body: dict[str, Any], headers: dict[str, str], on_event: Callable[[dict[str, Any]], None] | None
    ) -> Finished:
        self._running = True
        try:
            self._refuse_if_abandoned()
            answer = self._post_job_with_retry(body, headers | {"Idempotency-Key": str(uuid4())})
            if answer.status_code == httpx.codes.ACCEPTED:
                return self._follow_job(f"/v1/jobs/{answer.headers['location'].rpartition('/')[2]}", on_event)
        except BaseException as ending:  # Ctrl-C, a signal, a server that is gone: the motion is not followed any more
            self._stop_at(ending)
            raise
        finally:
            self._running = False
        raise JobRefusedError(reason_in(answer))

    def _follow_job(self, location: str, on_event: Callable[[dict[str, Any]], None] | None) -> Finished:
        for kind, data in self._job_events(location):
            if kind == "end":
                return Finished(data["state"], data["reason"], data["result"], data["elapsed_s"], data["job_id"])
            if on_event is not None:
                on_event(data)
        raise JobRefusedError("the server ended the events of the job before its end; look at its log")

    def _stop_at(self, ending: BaseException) -> None:
        try:
            self.stop()
        except httpx.HTTPError as error:
            ending.add_note(
                f"STOP is not confirmed ({error}); without this client control expires within {LEASE_TTL_S:.0f} s"
            )

    def stop_for_good(self) -> None:
        """From another thread: stop what this client runs, and let it begin nothing more."""
        self._abandoned.set()
        if self._running:
            self.stop()

    def _refuse_if_abandoned(self) -> None:
        if self._abandoned.is_set():
            raise JobRefusedError("ended before the job began")

    def _post_job_with_retry(self, body: dict[str, Any], headers: dict[str, str]) -> httpx.Response:
        """Send a command; when its answer is lost, send it again with the same key: it is carried out once."""
        for _ in range(RETRIES):
            try:
                return self._http.post("/v1/jobs", json=body, headers=headers)
            except httpx.TransportError:
                time.sleep(RETRY_DELAY_S)
        return self._http.post("/v1/jobs", json=body, headers=headers)

    def _job_events(self, location: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """The story to its end; a connection that breaks is taken up behind the last event."""
        last, broken = "0", 0
        while broken <= RETRIES:
            try:
                for number, kind, data in self._stream_events(location, last):
                    last, broken = number or last, 0
                    yield kind, data
                    if kind == "end":
                        return
                return
            except httpx.TransportError:
                broken += 1
                time.sleep(RETRY_DELAY_S)

    def _stream_events(self, location: str, last: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
        timeout, headers = httpx.Timeout(10.0, read=60.0), {"Last-Event-ID": last}
        with self._http.stream("GET", f"{location}/events", timeout=timeout, headers=headers) as stream:
            number = kind = ""
            for line in stream.iter_lines():
                if line.startswith("id: "):
                    number = line[4:]
                elif line.startswith("event: "):
                    kind = line[7:]
                elif line.startswith("data: "):
                    yield number, kind, json.loads(line[6:])
                    number = ""
