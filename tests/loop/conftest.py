"""The fault relay as a fixture, for every test here that speaks real UDP."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from sim_plc.relay.faults import Faults
from sim_plc.relay.relay_process import RelayFigures, UdpRelay
from sim_plc.relay.settings import RelaySettings


@dataclass
class RunningRelay:
    """A relay in a thread of this process. PCs send to `port`; `change` may be called at any time."""

    relay: UdpRelay
    done: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self.port = self.relay.address[1]
        self.thread = threading.Thread(target=self.relay.run, args=(self.done.is_set,))
        self.thread.start()

    def change(self, to_plc: Faults = Faults(), to_pc: Faults = Faults()) -> None:  # noqa: B008 frozen
        self.relay.change(to_plc, to_pc)

    @property
    def figures(self) -> RelayFigures:
        return self.relay.counts

    def close(self) -> None:
        self.done.set()
        self.thread.join()
        self.relay.close()


StartRelay = Callable[..., RunningRelay]


@pytest.fixture
def fault_relay() -> Iterator[StartRelay]:
    """`fault_relay(plc_port, to_plc=Faults(...), to_pc=Faults(...), seed=1)` starts one; all end with the test."""
    running: list[RunningRelay] = []

    def start(plc_port: int, to_plc: Faults | None = None, to_pc: Faults | None = None, seed: int = 1) -> RunningRelay:
        settings = RelaySettings(
            plc_port=plc_port, listen_port=0, seed=seed, to_plc=to_plc or Faults(), to_pc=to_pc or Faults()
        )
        running.append(RunningRelay(UdpRelay(settings)))
        return running[-1]

    yield start
    for relay in running:
        relay.close()
