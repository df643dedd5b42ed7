"""A process between PC and PLC that passes every datagram on at once and notes when commands went and what states said.

So both clients are measured by the same instrument, which is none of theirs: times are the kernel's receive stamps.
"""

import multiprocessing
import os
import selectors
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Self, cast

from protocol.codec import decode_state
from protocol.codes import MessageType, PlcState
from protocol.errors import RemoteProtocolError
from protocol.messages import State
from server.link.udp_end import Address, UdpEnd

_FIFO_PRIORITY = 60  # above both ends: it must not be what is late
_MSG_TYPE_OFFSET = 6
_FILLING_NS = 1_000_000_000  # of playback: until then the PLC's ring is being filled


@dataclass(slots=True)
class TapFigures:
    """What was seen since the last asking. Counters of the PLC as in its newest state."""

    sent_ns: list[int] = field(default_factory=list)  # commands, HELLOs not
    sent_in_run: list[bool] = field(default_factory=list)  # whether the PLC was in RUN then
    states: int = 0
    running: int = 0
    buffer_start_min_us: int | None = None  # in the first second of a trajectory
    buffer_min_us: int | None = None  # later, while knots were still to come
    underruns: int = 0
    lost_to_plc: int = 0
    watchdog_trips: int = 0
    last_state: str = ""


class _Tap:
    def __init__(self, plc: Address) -> None:
        self.front, self.back = UdpEnd(("127.0.0.1", 0)), UdpEnd(("127.0.0.1", 0))
        self.figures = TapFigures()
        self.last_knot = 0  # of the trajectory under way
        self._plc = plc
        self._pc: Address | None = None

    def from_pc(self) -> None:
        for datagram, t_ns, source in self.front.drain():
            self._pc = source
            self.back.send(datagram, self._plc)
            if datagram[_MSG_TYPE_OFFSET : _MSG_TYPE_OFFSET + 1] == bytes((MessageType.COMMAND,)):
                self.figures.sent_ns.append(t_ns)
                self.figures.sent_in_run.append(self.figures.last_state == PlcState.RUN.name)

    def from_plc(self) -> None:
        for datagram, _, _ in self.back.drain():
            if self._pc is not None:
                self.front.send(datagram, self._pc)
            with suppress(RemoteProtocolError):
                self._note(decode_state(datagram))

    def _note(self, state: State) -> None:
        figures = self.figures
        figures.states += 1
        figures.underruns, figures.lost_to_plc = state.underruns, state.rx_lost
        figures.watchdog_trips, figures.last_state = state.wd_trips, state.plc_state.name
        if state.plc_state is not PlcState.RUN:
            return
        figures.running += 1
        if state.knot_last >= self.last_knot:
            return
        if state.t_play_ns < _FILLING_NS:
            figures.buffer_start_min_us = _smaller(figures.buffer_start_min_us, state.buffer_us)
        else:
            figures.buffer_min_us = _smaller(figures.buffer_min_us, state.buffer_us)

    def take(self) -> TapFigures:
        taken = self.figures
        self.figures = TapFigures(
            underruns=taken.underruns,
            lost_to_plc=taken.lost_to_plc,
            watchdog_trips=taken.watchdog_trips,
            last_state=taken.last_state,
        )
        return taken


def _smaller(known: int | None, value: int) -> int:
    return value if known is None else min(known, value)


def run_tap(pipe: Connection, plc_port: int) -> None:
    """Until the pipe ends. Sends its port first. Told a number: the last knot to come; told None: sends the figures."""
    tap = _Tap(("127.0.0.1", plc_port))
    pipe.send(tap.front.local_address[1])
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    with selectors.DefaultSelector() as selector, suppress(EOFError, OSError):
        selector.register(tap.front, selectors.EVENT_READ, tap.from_pc)
        selector.register(tap.back, selectors.EVENT_READ, tap.from_plc)
        selector.register(pipe, selectors.EVENT_READ, None)
        while True:
            for key, _ in selector.select():
                if key.data is not None:
                    key.data()
                elif (told := cast("int | None", pipe.recv())) is None:
                    pipe.send(tap.take())
                else:
                    tap.last_knot = told


class Tap(AbstractContextManager["Tap"]):
    """The process: started on entry, ended on exit; the PC sends to `port`."""

    def __init__(self, plc_port: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = cast("tuple[Connection, Connection]", context.Pipe())
        self._theirs = theirs
        self._process: BaseProcess = context.Process(
            target=run_tap, args=(theirs, plc_port), name="link-tap", daemon=True
        )
        self.port = 0

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid or 0

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        self.port = cast("int", self._pipe.recv())
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _tb: TracebackType | None
    ) -> None:
        self._pipe.close()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def expect(self, last_knot: int) -> None:
        """The trajectory that follows ends with this knot: from there on an empty buffer is no news."""
        self._pipe.send(last_knot)

    def take(self) -> TapFigures:
        """What was seen since the last call."""
        self._pipe.send(None)
        return cast("TapFigures", self._pipe.recv())
