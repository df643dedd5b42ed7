"""A small REST client for jobs: what `position`, the benches and a fleet program need."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Self

import httpx


class JobRefusedError(Exception):
    """The server refused a request; the text is the server's own."""


@dataclass(frozen=True, slots=True)
class Finished:
    """A job at its end."""

    state: str
    reason: str
    result: Any
    elapsed_s: float


class JobClient:
    """Starts jobs on one server and follows them to their end."""

    def __init__(self, url: str, timeout_s: float = 10.0) -> None:
        self._http = httpx.Client(base_url=url, timeout=timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until a job could start.

        Raises: JobRefusedError with the server's last reasons when that takes longer.
        """
        deadline, reasons = time.monotonic() + timeout_s, "server does not answer"
        while time.monotonic() < deadline:
            try:
                answer = self._http.get("/readyz")
                if answer.status_code == 200:
                    return
                reasons = "; ".join(answer.json().get("reasons", []))
            except httpx.TransportError as error:
                reasons = f"server does not answer ({error})"
            time.sleep(0.2)
        raise JobRefusedError(f"not ready after {timeout_s:.0f} s: {reasons}")

    def state(self) -> dict[str, Any]:
        """The state view."""
        return self._http.get("/v1/state").raise_for_status().json()

    def stop(self) -> None:
        """Stop motion (software)."""
        self._http.post("/v1/stop").raise_for_status()

    def run(self, body: dict[str, Any], on_event: Callable[[dict[str, Any]], None] | None = None) -> Finished:
        """Start a job and follow it to its end.

        Raises: JobRefusedError when the server does not start it.
        """
        answer = self._http.post("/v1/jobs", json=body)
        if answer.status_code != 202:
            raise JobRefusedError(answer.json().get("detail", answer.text))
        for kind, data in self._events(answer.headers["location"]):
            if kind == "end":
                return Finished(data["state"], data["reason"], data["result"], data["elapsed_s"])
            if on_event is not None:
                on_event(data)
        raise JobRefusedError("the server ended the story of the job before its end; look at its log")

    def _events(self, location: str) -> Iterator[tuple[str, dict[str, Any]]]:
        timeout = httpx.Timeout(10.0, read=60.0)
        with self._http.stream("GET", f"{location}/events", timeout=timeout) as stream:
            kind = ""
            for line in stream.iter_lines():
                if line.startswith("event: "):
                    kind = line[7:]
                elif line.startswith("data: "):
                    yield kind, json.loads(line[6:])
