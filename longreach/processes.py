"""Starting simulator and server as processes of their own, and ending them again."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from longreach.signals import end_as_by_ctrl_c, not_interrupted

STOP_S = 8.0


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port that is free now on the loopback interface."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass(frozen=True, slots=True)
class StackPorts:
    """The ports of one simulated stack."""

    http: int
    plc: int
    plc_local: int
    camera: int

    @classmethod
    def free(cls) -> "StackPorts":
        """Ports that are free now."""
        udp = socket.SOCK_DGRAM
        return cls(http=free_port(), plc=free_port(udp), plc_local=free_port(udp), camera=free_port())


@dataclass(slots=True)
class Stack:
    """One simulated machine and its server, as processes; a context manager that leaves nothing behind, on SIGTERM
    and SIGHUP neither.
    """

    ports: StackPorts
    preset: str = "realistic"
    seed: int = 1
    camera_rate_hz: float = 15.0
    truth_log: Path | None = None
    runs: Path | None = None
    settings_file: Path | None = None
    sim_options: tuple[str, ...] = ()  # further options of `longreach sim`
    log_folder: Path | None = None
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def url(self) -> str:
        """The server's address."""
        return f"http://127.0.0.1:{self.ports.http}"

    def __enter__(self) -> "Stack":
        end_as_by_ctrl_c()
        try:
            self.start_sim()
            self.start_server()
        except BaseException:  # Ctrl-C between the two: what is started already is ended
            self.close()
            raise
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _tb: TracebackType | None
    ) -> None:
        self.close()

    def start_sim(self) -> None:
        """Start PLC and camera."""
        command = ["sim", "--preset", self.preset, "--seed", str(self.seed), "--plc-port", str(self.ports.plc)]
        command += ["--camera-port", str(self.ports.camera), "--camera-rate-hz", str(self.camera_rate_hz)]
        if self.truth_log is not None:
            command += ["--truth-log", str(self.truth_log)]
        self._start("sim", [*command, *self.sim_options])

    def start_server(self) -> None:
        """Start the server."""
        command = ["serve", "--port", str(self.ports.http), "--plc-port", str(self.ports.plc)]
        command += ["--plc-local-port", str(self.ports.plc_local)]
        command += ["--camera-url", f"http://127.0.0.1:{self.ports.camera}/stream"]
        if self.runs is not None:
            command += ["--runs", str(self.runs)]
        if self.settings_file is not None:
            command += ["--settings", str(self.settings_file)]
        self._start("server", command)

    def close(self) -> None:
        """End all processes, the server first so that it can leave the machine holding."""
        with not_interrupted():
            for name in ("server", "sim"):
                process = self.processes.pop(name, None)
                if process is not None:
                    _end(process)

    def _start(self, name: str, command: list[str]) -> None:
        self._start_module(name, "longreach.cli", command)

    def _start_module(self, name: str, module: str, command: list[str]) -> None:
        output = None
        if self.log_folder is not None:
            self.log_folder.mkdir(parents=True, exist_ok=True)
            output = (self.log_folder / f"{name}.log").open("wb")
        self.processes[name] = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *command],
            stdout=output,
            stderr=subprocess.STDOUT if output else None,
            start_new_session=True,
        )
        if output is not None:
            output.close()


def _end(process: subprocess.Popen[bytes]) -> None:
    """SIGTERM, then SIGKILL for the whole group when it does not leave in time."""
    if process.poll() is None:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STOP_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(STOP_S)
