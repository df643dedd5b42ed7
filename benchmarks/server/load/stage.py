"""What the load bench runs, as processes of their own: PLC, replayed camera, server; and a watch on the server."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from benchmarks.kills.plc_process import PlcProcess
from benchmarks.kills.victims import children_of, holder_of_udp_port
from benchmarks.link.load.replay_camera import ReplayCamera
from benchmarks.link.load.usage import cpu_s
from benchmarks.server.load.block import Block
from benchmarks.server.load.clients import ClientProcess, Demand, Seen
from benchmarks.server.load.mover import Mover
from longreach.fleet_client import JobClient
from longreach.processes import Stack, StackPorts
from sim_plc.process import SimSettings

READY_S = 240.0  # the first start on a machine compiles
SETTLE_S = 3.0


class BusyStack(Stack):
    """A server whose odometry is on from the start."""

    def _start(self, name: str, command: list[str]) -> None:
        self._start_module(name, "benchmarks.server.load.server_process", command)


@dataclass(slots=True)
class Watch:
    """What the server tells of itself about twice a second."""

    http: httpx.Client
    looks: int = 0
    running: int = 0
    underruns: int = 0
    _last: int = field(default=-1)

    def look(self) -> None:
        """Note the PLC's mode and its underruns, whose counter begins anew with a session."""
        link = self.http.get("/v1/state").raise_for_status().json()["link"]
        now = int(link["underruns"])
        if self._last >= 0:
            self.underruns += now - self._last if now >= self._last else now
        self._last = now
        self.looks += 1
        self.running += link["plc_state"] == "RUN"

    def pairs(self) -> float:
        """Stereo pairs worked through since the server's start."""
        text = self.http.get("/metrics").raise_for_status().text
        return next(float(line.split()[1]) for line in text.splitlines() if line.startswith("longreach_camera_pairs_t"))

    def reset(self) -> None:
        """Begin to count anew."""
        self.looks = self.running = self.underruns = 0


@dataclass(slots=True)
class Stage:
    """A machine at work under load, of which blocks are measured."""

    stack: Stack
    watch: Watch
    mover: Mover
    replay_hz: float
    pids: dict[str, int]

    def block(self, number: int, asked: Demand, clients: bool) -> Block:
        """Measure for that long."""
        wanted = asked if clients else Demand(asked.port, 0, 0.0, asked.seconds)
        with ClientProcess(wanted) as clients_process:
            self.watch.reset()
            self.watch.look()
            self.mover.taken()
            before, pairs, started_s = self._cpu(), self.watch.pairs(), time.monotonic()
            seen = clients_process.demand(self.watch.look)
            took_s, pairs = time.monotonic() - started_s, self.watch.pairs() - pairs
        cpu = {name: round((spent - before.get(name, 0.0)) / took_s, 3) for name, spent in self._cpu().items()}
        cpu["clients"] = round(seen.cpu_s / took_s, 3)
        return self._told(number, clients, took_s, pairs, cpu, seen)

    def _told(
        self, number: int, clients: bool, took_s: float, pairs: float, cpu: dict[str, float], seen: Seen
    ) -> Block:
        return Block(
            number=number,
            clients=clients,
            seconds=took_s,
            pairs=pairs,
            replay_hz=self.replay_hz,
            underruns=self.watch.underruns,
            run_frac=self.watch.running / max(1, self.watch.looks),
            jobs=self.mover.taken(),
            cpu_frac=cpu,
            load_average=os.getloadavg()[0],
            latencies_us=seen.latencies_us,
            statuses={str(status): count for status, count in seen.statuses.items()},
            broken=seen.broken,
            late_start_max_us=seen.late_start_max_us,
            events=seen.events,
            event_bytes=seen.event_bytes,
            readers_at_end=seen.readers_at_end,
            reader_events_min=seen.reader_events_min,
        )

    def _cpu(self) -> dict[str, float]:
        return {name: cpu_s(pid) for name, pid in self.pids.items()}


@contextmanager
def stage(
    machine_text: str, preset: str, seed: int, pairs: list[Path], replay_hz: float, folder: Path
) -> Iterator[Stage]:
    """Start everything and wait until it is at work; nothing of it is left afterwards.

    Raises: longreach.fleet_client.JobRefusedError: the server was not ready in time.
    """
    free = StackPorts.free()
    settings = SimSettings(machine_text, preset, seed, plc_port=free.plc, camera=False)
    with PlcProcess(settings) as plc, ReplayCamera(pairs, replay_hz) as camera:
        ports = StackPorts(free.http, free.plc, free.plc_local, int(camera.url.rsplit(":", 1)[1].split("/")[0]))
        stack = BusyStack(ports, runs_folder=folder / "runs", log_folder=folder / "logs")
        try:
            stack.start_server()
            with JobClient(stack.url) as client:
                client.wait_ready(READY_S)
            pids = {"plc": plc.pid, "camera": camera.pid, "bench": os.getpid()}
            pids |= _parts(stack.processes["server"].pid, free.plc_local)
            with httpx.Client(base_url=stack.url, timeout=30.0) as http, Mover(stack.url) as mover:
                time.sleep(SETTLE_S)
                yield Stage(stack, Watch(http), mover, replay_hz, pids)
        finally:
            stack.close()


def _parts(server_pid: int, plc_local: int) -> dict[str, int]:
    """The server's main process, its link (it holds the UDP port) and vision (the one that has cost most so far)."""
    link = holder_of_udp_port(plc_local, server_pid)
    others = [pid for pid in children_of(server_pid) if pid != link]
    named = {"server": server_pid, "link": link, "vision": max(others, key=cpu_s, default=None)}
    return {name: pid for name, pid in named.items() if pid is not None}
