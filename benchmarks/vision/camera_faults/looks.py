"""Looks started all the time, as an operator might: which pairs did those use that ended OK?"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from server.camera.contracts import FrameReport
from server.camera.looking import LookCollector
from server.vision.contracts import Look, LookStatus, PairObservation
from server.vision.look import average_look

LOOK_PAIRS = 10
START_EVERY = 4
EXPOSURE_SLACK_NS = 200_000_000  # as the server's settings
LIFE_PAIRS = 60


@dataclass(slots=True)
class _Look:
    collector: LookCollector
    ends: int
    taken: list[PairObservation] = field(default_factory=list)

    def average(self, pairs: Sequence[PairObservation]) -> Look:
        self.taken = list(pairs)
        return average_look(pairs)


@dataclass(slots=True)
class Looks:
    """A new look every few pairs; each lives until it ends or time is up."""

    used: set[int] = field(default_factory=set)  # numbers of pairs that entered a look that ended OK
    ended_ok: list[Look] = field(default_factory=list)
    _open: list[_Look] = field(default_factory=list)
    _numbers: dict[int, int] = field(default_factory=dict)
    _kept: list[PairObservation] = field(default_factory=list)

    def add(self, number: int, report: FrameReport) -> None:
        """Give a report to all open looks."""
        self._numbers[id(report.observation)] = number
        self._kept.append(report.observation)  # so that ids stay unique
        if number % START_EVERY == 0:
            self._start(number, report.t_receive_mono_ns)
        for look in tuple(self._open):
            done = look.collector.add(report)
            if done is not None and done.status is LookStatus.OK:
                self.ended_ok.append(done)
                self.used |= {self._numbers[id(one)] for one in look.taken}
            if done is not None or number >= look.ends:
                self._open.remove(look)

    def _start(self, number: int, t_receive_ns: int) -> None:
        look = _Look(None, number + LIFE_PAIRS)  # pyright: ignore[reportArgumentType]  # set in the next line
        look.collector = LookCollector(LOOK_PAIRS, t_receive_ns + EXPOSURE_SLACK_NS, "stereo", look.average)
        self._open.append(look)
