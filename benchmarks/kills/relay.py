"""A relay between PC and PLC that goes on listening when one of them is dead."""

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable
from typing import Self

from protocol.codec import decode_state
from protocol.errors import RemoteProtocolError
from protocol.messages import State
from recording.clock import mono_ns

_POLL_S = 0.1
_DATAGRAM = 4096


class Relay(threading.Thread):
    """Passes raw datagrams between a PC, which sends to `port`, and a PLC; keeps the PLC's states."""

    def __init__(self, plc_port: int, host: str = "127.0.0.1") -> None:
        super().__init__(name="plc-relay", daemon=True)
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind((host, 0))
        self._back.connect((host, plc_port))
        self.port: int = self._front.getsockname()[1]
        self.states: list[State] = []
        self.t_last_state_ns = 0  # monotonic
        self._pc: tuple[str, int] | None = None
        self._stopped = threading.Event()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def run(self) -> None:
        """Pass on until closed."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._front, selectors.EVENT_READ, self._from_pc)
            selector.register(self._back, selectors.EVENT_READ, self._from_plc)
            while not self._stopped.is_set():
                for key, _ in selector.select(_POLL_S):
                    with contextlib.suppress(ConnectionError):  # one of both is not there (any more)
                        key.data()
        self._front.close()
        self._back.close()

    def close(self) -> None:
        """End the thread and let go of both ports."""
        self._stopped.set()
        self.join()

    def _from_pc(self) -> None:
        datagram, self._pc = self._front.recvfrom(_DATAGRAM)
        self._back.send(datagram)

    def _from_plc(self) -> None:
        datagram = self._back.recv(_DATAGRAM)
        with contextlib.suppress(RemoteProtocolError):  # passed on all the same: refusing it is the PC's business
            self.states.append(decode_state(datagram))
            self.t_last_state_ns = mono_ns()
        if self._pc is not None:
            self._front.sendto(datagram, self._pc)

    def wait(self, wanted: Callable[[State], bool], timeout_s: float, what: str) -> State:
        """The newest state as soon as it is as wanted.

        Raises: TimeoutError: saying what did not come, and what the PLC said last.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self.states and wanted(self.states[-1]):
                return self.states[-1]
            time.sleep(0.002)
        newest = self.states[-1].plc_state.name if self.states else "no state at all"
        raise TimeoutError(f"{what}: not within {timeout_s} s; the PLC said {newest}")
