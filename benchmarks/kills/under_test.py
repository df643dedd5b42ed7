"""The server under test, used as a fleet program would: over REST. It may be killed and started again."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import httpx

from benchmarks.kills.victims import holder_of_udp_port
from longreach.processes import Stack, StackPorts

START_S = 120.0  # the first start on a machine compiles
_POLL_S = 0.02


class ServerUnderTest:
    """One server on the relay's port, without a camera; every start of it gets a new HTTP port."""

    def __init__(self, plc_port: int, machine_file: Path, folder: Path) -> None:
        self._plc_port, self._folder = plc_port, folder
        self._settings = folder / "server.toml"
        self._settings.write_text(f'machine_file = "{machine_file}"\n[recording]\nimages = false\n', encoding="utf-8")
        self._stack: Stack | None = None
        self._http: httpx.Client | None = None
        self._starts = 0
        self._lease = ""

    def start(self) -> None:
        """Start it and wait until it has linked with the PLC.

        Raises: TimeoutError: it has not.
        """
        free = StackPorts.free()
        ports = StackPorts(http=free.http, plc=self._plc_port, plc_local=free.plc_local, camera=free.camera)
        self._starts += 1
        self._stack = Stack(
            ports,
            runs_folder=self._folder / "runs",
            settings_file=self._settings,
            log_folder=self._folder / f"server-{self._starts}",
        )
        self._stack.start_server()
        self._http = httpx.Client(base_url=self._stack.url, timeout=10.0)
        self.wait_linked(START_S)

    def wait_linked(self, timeout_s: float) -> None:
        """Wait until it is in session with the PLC.

        Raises: TimeoutError: it is not; with the phase it is in.
        """
        deadline, phase = time.monotonic() + timeout_s, "no answer"
        while time.monotonic() < deadline:
            try:
                phase = self._get("/v1/state")["link"]["phase"]
            except httpx.TransportError:
                phase = "no answer"
            if phase == "linked":
                return
            time.sleep(5 * _POLL_S)
        raise TimeoutError(f"server not linked within {timeout_s:.0f} s; its link is '{phase}'")

    @property
    def pid(self) -> int:
        """Of the server's main process."""
        if self._stack is None:
            raise RuntimeError("the server is not started; start it first")
        return self._stack.processes["server"].pid

    @property
    def http_port(self) -> int:
        """Where it serves REST and panel."""
        if self._stack is None:
            raise RuntimeError("the server is not started; start it first")
        return self._stack.ports.http

    @property
    def link_pid(self) -> int:
        """Of its link process."""
        pid = holder_of_udp_port(self._stack.ports.plc_local, self.pid) if self._stack else None
        if pid is None:
            raise RuntimeError("the server has no link process; look at its log")
        return pid

    def kill(self) -> None:
        """SIGKILL of the main process alone; link and vision see that it is gone."""
        os.kill(self.pid, signal.SIGKILL)

    def kill_link(self) -> None:
        """SIGKILL of the link process alone; the server starts another."""
        os.kill(self.link_pid, signal.SIGKILL)

    def kill_all(self) -> None:
        """SIGKILL of the main process, link and vision at once."""
        os.killpg(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """End what is left of it."""
        if self._http is not None:
            self._http.close()
        if self._stack is not None:
            self._stack.close()
        self._stack = self._http = None

    # --- jobs -------------------------------------------------------------------------------------------------------

    def start_job(self, body: dict[str, Any], headers: dict[str, str] | None = None) -> str:
        """Start a job under control of this drill; its id.

        Raises: httpx.HTTPStatusError: refused.
        """
        answer = self._client.post("/v1/jobs", json=body, headers=self._control() | (headers or {}))
        return answer.raise_for_status().json()["job_id"]

    def _control(self) -> dict[str, str]:
        """Headers of control: the lease of before if this server still knows it, else a new one for two minutes."""
        kept = self._lease and self._client.put(f"/v1/lease/{self._lease}")
        if not kept or kept.is_error:
            kept = self._client.post("/v1/lease", json={"owner": "kill drill", "ttl_s": 120.0}).raise_for_status()
        lease = kept.json()
        self._lease = lease["lease_id"]
        return {"Longreach-Lease": self._lease, "Longreach-Fencing": str(lease["fencing"])}

    def job(self, job_id: str) -> dict[str, Any]:
        """The job as the server reports it; empty if it does not know it."""
        answer = self._client.get(f"/v1/jobs/{job_id}")
        return {} if answer.status_code == httpx.codes.NOT_FOUND else answer.raise_for_status().json()

    def newest_job(self) -> dict[str, Any]:
        """The job that was started last, whoever started it."""
        return self._get("/v1/jobs")[-1]

    def wait_ended(self, job_id: str, timeout_s: float) -> dict[str, Any]:
        """The job at its end, or as it is when time is up."""
        deadline = time.monotonic() + timeout_s
        while True:
            job = self.job(job_id)
            if not job or job["state"] not in ("running", "stopping") or time.monotonic() > deadline:
                return job
            time.sleep(_POLL_S)

    def planned_s(self, job_id: str, timeout_s: float) -> float:
        """How long the job's move will take, as soon as it is planned [s].

        Raises: TimeoutError: it was not planned; with the job's story.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            job = self.job(job_id)
            for event in job.get("events", []):
                if event["name"] == "move":
                    return float(event["target"])
            if job.get("state") == "failed":
                raise TimeoutError(f"the job ended before it moved: {job['reason']}")
            time.sleep(_POLL_S)
        raise TimeoutError(f"the job did not begin to move within {timeout_s:.0f} s")

    @property
    def _client(self) -> httpx.Client:
        if self._http is None:
            raise RuntimeError("the server is not started; start it first")
        return self._http

    def _get(self, path: str) -> Any:
        return self._client.get(path).raise_for_status().json()
