"""One case: a good stream, a fault that comes and goes, and what the server made of it."""

from dataclasses import dataclass

from benchmarks.vision.camera_faults.camera import Arrival, Line
from benchmarks.vision.camera_faults.looks import Looks
from benchmarks.vision.camera_faults.pictures import RATE_HZ, Pictures
from machine.description import Machine
from server.camera.contracts import FrameReport, VisionSettings
from server.camera.health.image_health import ImageHealth
from server.camera.health.stamps import silence_text
from server.camera.pipeline import VisionPipeline
from server.camera.process import build_pipeline
from server.camera.sources.settings import HttpSource
from sim_plc.camera.faults import FaultKind

BEFORE_PAIRS = 40
FAULT_PAIRS = 40
MOTION_FAULT_PAIRS = 200  # of what shows only while the scene moves
AFTER_PAIRS = 40
MAPPED_MAX_S = 0.02  # error of an exposure's time: beyond, a pair counts as faulty although its pictures are good
IN_MOTION_ONLY = frozenset({FaultKind.SPOT})
NOTICES = frozenset({FaultKind.SPOT})  # told, but no reason to refuse a look
AT_REST_ONLY = frozenset({FaultKind.MARKER_TWICE, FaultKind.MARKER_MOVED})
ONCE = frozenset({FaultKind.STAMP_AHEAD, FaultKind.STAMP_BACK})  # a clock that was set is right again afterwards


@dataclass(frozen=True, slots=True)
class FaultCase:
    """What came of one fault. `found_after`: faulty exposures until the first finding, 1 = at once; None = never.

    `n_used`: faulty pairs that entered a look that ended OK; `n_ok`: such looks in the whole case.
    `recovered_after`: good pairs from the end of the fault to the first usable one.
    """

    kind: str
    seed: int
    moving: bool
    found_after: int | None
    name: str
    n_used: int
    n_ok: int
    recovered_after: int | None
    false_alarms: int
    good_pairs: int


def new_pipeline(machine: Machine) -> VisionPipeline:
    """The server's own pipeline, odometry on."""
    pipeline = build_pipeline(VisionSettings(HttpSource("http://unused/")), machine)
    pipeline.switch_odometry(True)
    return pipeline


@dataclass(slots=True)
class _Seen:
    """One exposure as the server saw it."""

    faulty: bool
    usable: bool
    text: str


def run_case(machine: Machine, pictures: Pictures, kind: FaultKind, seed: int, moving: bool) -> FaultCase:
    """Good pairs, the fault, good pairs again."""
    n_fault = MOTION_FAULT_PAIRS if kind in IN_MOTION_ONLY else FAULT_PAIRS
    line, looks, pipeline = Line(seed), Looks(), new_pipeline(machine)
    stream = pictures.stream(moving, seed)
    seen: list[_Seen] = []
    notices = ImageHealth(machine.camera) if kind in NOTICES else None
    last_ns = 0
    faulty_numbers: set[int] = set()
    for number in range(BEFORE_PAIRS + n_fault + AFTER_PAIRS):
        faulty = BEFORE_PAIRS <= number < BEFORE_PAIRS + n_fault
        line.switch.kind = kind if faulty else FaultKind.NONE
        views = next(stream)
        arrival = line.send(views.get(line.switch.kind, views[FaultKind.NONE]))
        if arrival.frame is None:
            seen.append(_silent(arrival, last_ns, faulty))
            continue
        last_ns = arrival.t_receive_ns
        report = pipeline.process(arrival.frame, 0)
        looks.add(number, report)
        if faulty and kind not in NOTICES and (kind not in ONCE or _badly_mapped(report, arrival)):
            faulty_numbers.add(number)
        told = [] if notices is None else [one.text for one in notices.before_use(arrival.frame)]
        texts = [*report.warnings, *told]
        seen.append(_Seen(faulty, not texts, texts[0] if texts else ""))
    pipeline.close()
    return _verdict(kind, seed, moving, seen, n_fault, len(looks.used & faulty_numbers), len(looks.ended_ok))


def _badly_mapped(report: FrameReport, arrival: Arrival) -> bool:
    late_s = (report.t_exposure_mapped_ns - arrival.t_true_ns) * 1e-9
    return not -MAPPED_MAX_S <= late_s <= MAPPED_MAX_S + 0.06  # a camera's own latency of up to 60 ms stays in it


def _silent(arrival: Arrival, last_ns: int, faulty: bool) -> _Seen:
    """No pair: the source's words, or the silence itself once it is long enough."""
    findings = silence_text(last_ns, arrival.t_receive_ns)
    if arrival.reason != "no picture":
        return _Seen(faulty, False, arrival.reason)
    return _Seen(faulty, not findings, findings[0].text if findings else "")


def _verdict(
    kind: FaultKind, seed: int, moving: bool, seen: list[_Seen], n_fault: int, n_used: int, n_ok: int
) -> FaultCase:
    during = seen[BEFORE_PAIRS : BEFORE_PAIRS + n_fault]
    after = seen[BEFORE_PAIRS + n_fault :]
    found = next((number for number, one in enumerate(during) if not one.usable), None)
    recovered = next((number for number, one in enumerate(after) if one.usable), None)
    return FaultCase(
        kind=kind.value,
        seed=seed,
        moving=moving,
        found_after=None if found is None else found + 1,
        name="" if found is None else during[found].text,
        n_used=n_used,
        n_ok=n_ok,
        recovered_after=None if recovered is None else recovered + 1,
        false_alarms=sum(not one.usable for one in seen[:BEFORE_PAIRS]),
        good_pairs=BEFORE_PAIRS,
    )


__all__ = ["RATE_HZ", "FaultCase", "new_pipeline", "run_case"]
