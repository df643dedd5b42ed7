"""What the soak runs: simulated PLC and camera, a relay between both ends, the server; and hands on each of them."""

import os
import signal
import sqlite3
import threading
import time
from contextlib import closing, suppress
from multiprocessing import shared_memory
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx

from benchmarks.kills.plc_process import shared_memories_of
from longreach.processes import Stack, StackPorts
from sim_plc.relay.faults import Faults
from sim_plc.relay.relay_process import UdpRelay
from sim_plc.relay.settings import RelaySettings

OWNER = "soak"
_NO_FAULTS = Faults()


class Stand:
    """A context manager; nothing of it is left afterwards."""

    def __init__(self, preset: str, seed: int, folder: Path, machine_file: Path | None = None) -> None:
        ports = StackPorts.free()
        machine = ("--machine", str(machine_file)) if machine_file else ()
        self._sim = Stack(ports, preset, seed, sim_options=("--camera-faults", *machine), log_folder=folder / "logs")
        settings_file = _settings(folder, machine_file) if machine_file else None
        self._relay = UdpRelay(RelaySettings(plc_port=ports.plc, listen_port=0, seed=seed))
        behind = StackPorts(ports.http, self._relay.address[1], ports.plc_local, ports.camera)
        self._server = Stack(
            behind, preset, seed, runs_folder=folder / "runs", settings_file=settings_file, log_folder=folder / "logs"
        )
        self.http = httpx.Client(base_url=self._server.url, timeout=30.0)
        self._database = folder / "runs" / "longreach.sqlite3"
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._relay.run, args=(self._stopped.is_set,), name="relay", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        try:
            self._sim.start_sim()
            self._server.start_server()
        except OSError:
            self.close()
            raise
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _tb: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End everything, the server first."""
        self.http.close()
        self._server.close()
        self._sim.close()
        self._stopped.set()
        self._thread.join(5.0)
        self._relay.close()

    @property
    def url(self) -> str:
        """The server's address."""
        return self._server.url

    @property
    def server_pid(self) -> int:
        """Of its main process."""
        return self._server.processes["server"].pid

    @property
    def link_port(self) -> int:
        """UDP port of the server's link process."""
        return self._server.ports.plc_local

    # --- faults -----------------------------------------------------------------------------------------------------

    def relay(self, faults: Faults = _NO_FAULTS) -> None:
        """Other faults in both directions from now on."""
        self._relay.change(faults, faults)

    def camera(self, kind: str = "none") -> None:
        """Another fault of the camera from now on."""
        with suppress(httpx.TransportError):  # a camera that is just being started anew has none
            httpx.post(f"http://127.0.0.1:{self._sim.ports.camera}/fault", json={"kind": kind}, timeout=5.0)

    def kill_sim(self) -> None:
        """SIGKILL of PLC and camera, and another life of both, at the pose of the first one."""
        process = self._sim.processes.pop("sim")
        left = shared_memories_of(process.pid)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for name in left:
            with suppress(FileNotFoundError):
                memory = shared_memory.SharedMemory(name=name)
                memory.close()
                memory.unlink()
        self._sim.start_sim()

    def cancel(self) -> None:
        """Cancel the job that runs, if one does."""
        job = self.state()["job"]
        if job is not None:
            self.http.post(f"/v1/jobs/{job['job_id']}/cancel")

    def stop(self) -> None:
        """Stop whatever moves."""
        self.http.post("/v1/stop")

    # --- looking ----------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """The state view. Raises: httpx.HTTPError."""
        return self._got("/v1/state").json()

    def metrics(self) -> dict[str, float]:
        """Figures without labels. Raises: httpx.HTTPError."""
        rows = (line.rsplit(" ", 1) for line in self._got("/metrics").text.splitlines() if not line.startswith("#"))
        return {name: float(value) for name, value in rows}

    def store_bytes(self) -> float:
        """Of the database's pages; the write-ahead log beside it grows to 4 MiB and is then used anew."""
        with closing(sqlite3.connect(f"{self._database.absolute().as_uri()}?mode=ro", uri=True)) as db:
            pages, size = (db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
        return float(pages * size)

    def _got(self, path: str) -> httpx.Response:
        for _ in range(3):  # a kept-alive connection may be closed just as it is used
            with suppress(httpx.TransportError):
                return self.http.get(path).raise_for_status()
            time.sleep(0.1)
        return self.http.get(path).raise_for_status()

    def recover(self, timeout_s: float) -> str:
        """Take away every fault, reset a latched one, wait until a job could start. Empty: it can; else why not."""
        self.relay()
        self.camera()
        deadline, reasons = time.monotonic() + timeout_s, ["no answer"]
        while time.monotonic() < deadline:
            with suppress(httpx.HTTPError):
                answer = self.http.get("/readyz")
                if answer.status_code == httpx.codes.OK:
                    return ""
                reasons = answer.json()["reasons"]
                if self.state()["link"]["phase"] == "fault":
                    self._reset()
            time.sleep(0.2)
        return f"not ready {timeout_s:.0f} s after the job: {'; '.join(reasons)}"

    def _reset(self) -> None:
        lease = self.http.post("/v1/lease", json={"owner": OWNER, "kind": "operator", "ttl_s": 15.0})
        if lease.status_code != httpx.codes.CREATED:
            return
        held = lease.json()
        headers = {"Longreach-Lease": held["lease_id"], "Longreach-Fencing": str(held["fencing"])}
        self.http.post("/v1/reset", headers=headers)
        self.http.delete(f"/v1/lease/{held['lease_id']}")


def _settings(folder: Path, machine_file: Path) -> Path:
    """A server that knows the same machine file as the simulator."""
    path = (folder / "server.toml").resolve()
    path.write_text(f'machine_file = "{machine_file}"\n', encoding="utf-8")
    return path
