"""The simulated PLC without its camera, in a process of its own that may be killed and started again on its port."""

import contextlib
import multiprocessing
import socket
from contextlib import AbstractContextManager
from multiprocessing import shared_memory
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Self, cast

from longreach.processes import free_port
from sim_plc.process import SimSettings, run_sim
from sim_plc.real_time import LoopHealth

_STOP_S = 15.0


class PlcProcess(AbstractContextManager["PlcProcess"]):
    """Started on entry, ended by SIGTERM on exit. `settings.plc_port` stays the same over restarts."""

    def __init__(self, settings: SimSettings) -> None:
        self.settings = settings
        self._process: BaseProcess | None = None
        self._reports: Connection | None = None
        self.health: LoopHealth | None = None  # how it has kept up with real time; after its end

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _tb: TracebackType | None
    ) -> None:
        self.end()

    @property
    def process(self) -> BaseProcess:
        """The running process."""
        if self._process is None:
            raise RuntimeError("the PLC process is not started; start it first")
        return self._process

    @property
    def pid(self) -> int:
        """Of the running process."""
        return self.process.pid or 0

    def start(self) -> None:
        """Start it, or start it anew."""
        context = multiprocessing.get_context("spawn")
        self._reports, theirs = cast("tuple[Connection, Connection]", context.Pipe(duplex=False))
        self._process = context.Process(target=_run_and_tell, args=(self.settings, theirs))
        self._process.start()
        theirs.close()

    def kill(self) -> None:
        """SIGKILL: no farewell of any kind. What shared memory it leaves behind is removed."""
        left = shared_memories_of(self.pid)
        self.process.kill()
        self.process.join()
        for name in left:
            with contextlib.suppress(FileNotFoundError):
                memory = shared_memory.SharedMemory(name=name)
                memory.close()
                memory.unlink()

    def end(self) -> None:
        """SIGTERM, and SIGKILL when that does not help."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        process.join(_STOP_S)
        if process.is_alive():
            process.kill()
            process.join()
        if self._reports is not None:
            with contextlib.suppress(EOFError, OSError):
                self.health = cast("LoopHealth", self._reports.recv())
            self._reports.close()


def _run_and_tell(settings: SimSettings, pipe: Connection) -> None:
    """Entry point of the process: the simulator, and at its end how it has kept up."""
    pipe.send(run_sim(settings))


def free_udp_port() -> int:
    """A UDP port that is free now."""
    return free_port(socket.SOCK_DGRAM)


def shared_memories_of(pid: int) -> set[str]:
    """Names of the shared memories of Python's making that a process has mapped (Linux)."""
    maps = Path(f"/proc/{pid}/maps")
    lines = maps.read_text(encoding="utf-8").splitlines() if maps.exists() else []
    return {Path(line.split()[-1]).name for line in lines if "/dev/shm/psm_" in line}
