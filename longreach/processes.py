"""Starting simulator and server as processes of their own, and ending them again."""

import contextlib
import errno
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from longreach.signals import end_as_by_ctrl_c, not_interrupted
from server.errors import SettingsError

PROCESS_STOP_TIMEOUT_S = 8.0


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
    runs_folder: Path | None = None
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
        if self.runs_folder is not None:
            command += ["--runs", str(self.runs_folder)]
        if self.settings_file is not None:
            command += ["--settings", str(self.settings_file)]
        self._start("server", command)

    def close(self) -> None:
        """End all processes, the server first so that it can leave the machine holding."""
        with not_interrupted():
            for name in ("server", "sim"):
                process = self.processes.pop(name, None)
                if process is not None:
                    _stop_process_group(process)

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


def _stop_process_group(process: subprocess.Popen[bytes]) -> None:
    """SIGTERM, then SIGKILL for the whole group when it does not leave in time."""
    if process.poll() is None:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PROCESS_STOP_TIMEOUT_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(PROCESS_STOP_TIMEOUT_S)


# Check every listening address before anything starts; one line names the faulty one.

BIND_RETRY_DELAY_S = 0.5
RETRYABLE_BIND_ERRNOS = (errno.EADDRNOTAVAIL, errno.ENODEV)  # as at boot, before the network is up


@dataclass(frozen=True, slots=True)
class Address:
    """Where something is going to listen. `host_option`, `port_option`: what gives another host or port."""

    host: str
    port: int
    host_option: str
    port_option: str
    socket_kind: socket.SocketKind = socket.SOCK_STREAM
    address_family: socket.AddressFamily = socket.AF_UNSPEC
    taken_by: str = "another program; give another one"

    def try_it(self) -> None:
        """Bind and let go. Raises: OSError."""
        infos = socket.getaddrinfo(self.host, self.port, self.address_family, self.socket_kind, flags=socket.AI_PASSIVE)
        for family, kind, protocol, _, where in infos:
            with socket.socket(family, kind, protocol) as probe:
                if kind is socket.SOCK_STREAM:
                    probe.setsockopt(
                        socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
                    )  # what an ended program left does not count
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind(where)

    @classmethod
    def of_plc_link(cls, host: str, port: int, taken_by: str) -> Self:
        """Our end of the link to the PLC. `taken_by`: what most likely has it, and what to do."""
        kinds = (socket.SOCK_DGRAM, socket.AF_INET)
        return cls(host, port, "[plc] local_host", "--plc-local-port", *kinds, taken_by)

    def explain_error(self, error: OSError) -> str:
        """What is wrong, and what to do."""
        udp = "udp " if self.socket_kind is socket.SOCK_DGRAM else ""
        if error.errno == errno.EADDRINUSE:
            return f"{udp}port {self.port} is taken by {self.taken_by} by {self.port_option}"
        if isinstance(error, socket.gaierror) or error.errno in RETRYABLE_BIND_ERRNOS:
            return (
                f"'{self.host}' is not an address of this computer ({error.strerror}); give one by {self.host_option}"
            )
        return f"{udp}port {self.port} on '{self.host}': {error.strerror}; give another one by {self.port_option}"


def require_bindable(
    addresses: Sequence[Address], wait_s: float = 0.0, waiting: Callable[[str], None] = lambda _text: None
) -> None:
    """Try all of them. An address that this computer does not have yet is waited for; `waiting` is called once.

    Raises: SettingsError: the first that nothing can listen on, and why.
    """
    until_s, announced = time.monotonic() + wait_s, False
    for address in addresses:
        while True:
            try:
                address.try_it()
                break
            except OSError as error:
                missing = isinstance(error, socket.gaierror) or error.errno in RETRYABLE_BIND_ERRNOS
                if not missing or time.monotonic() >= until_s:
                    raise SettingsError(address.explain_error(error)) from error
            if not announced:
                waiting(
                    f"'{address.host}' is not an address of this computer yet; waiting for it, {wait_s:.0f} s at most"
                )
                announced = True
            time.sleep(min(BIND_RETRY_DELAY_S, max(0.0, until_s - time.monotonic())))
