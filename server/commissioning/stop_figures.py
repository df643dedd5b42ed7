"""What a stop did, from the PLC's states alone: when the ramp began, how long it took, how far the tool went. Pure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_poses
from server.link.contracts import PlcSample

STANDSTILL_SPEED_MAX_RAD_S = 0.003  # encoders: the boom has stopped swinging
_MOVING = ("RUN", "STOPPING")
_TAKEN_AWAY = ("FAULT", "LOCAL", "BOOT")


@dataclass(frozen=True, slots=True)
class StopFigures:
    """One stop. Times count from the trigger, on the PLC's clock; NaN: it did not come."""

    reaction_ms: float  # until STOPPING
    ramp_ms: float  # from STOPPING to a resting reference
    ramp_bound_ms: float  # max |qd_ref| / qdd_max as the ramp began
    machine_still_ms: float  # until the encoders rest
    tcp_speed_mm_s: float  # at the trigger, by encoders
    tcp_travel_mm: float  # from the trigger to standstill, by encoders
    void_ms: float  # until DISARMED
    resumed: bool  # RUN again after the stop
    faulted: bool  # a fault or the lever ended it, not the stop


def stop_figures(samples: Sequence[PlcSample], t_trigger_plc_ns: int, machine: Machine) -> StopFigures:
    """The figures of one stop.

    Model:   bound = max over joints of |qd_ref| / qdd_max at the last state of RUN.
    Args:    samples: from before the trigger until well after standstill, oldest first.
    Raises:  ValueError: no state of RUN before the trigger.
    """
    at = next((i for i, sample in enumerate(samples) if sample.t_plc_ns >= t_trigger_plc_ns), len(samples))
    if at == 0 or samples[at - 1].plc_state != "RUN":
        raise ValueError("no motion when the stop was requested; make the move longer")
    begin = _first_state_index(samples, at, lambda state: state != "RUN")
    rest = None if begin is None else _first_state_index(samples, begin, lambda state: state not in _MOVING)

    def ms(index: int | None, since_ns: int = t_trigger_plc_ns) -> float:
        return float("nan") if index is None else (samples[index].t_plc_ns - since_ns) / 1e6

    qdd_max = np.array([joint.qdd_max_rad_s2 for joint in machine.joints])
    qd = np.array(samples[at - 1 if begin is None else begin - 1].qd_ref_rad_s)
    here, last = samples[at - 1], samples[-1]
    return StopFigures(
        reaction_ms=ms(begin),
        ramp_ms=ms(rest, t_trigger_plc_ns if begin is None else samples[begin].t_plc_ns),
        ramp_bound_ms=1e3 * float((np.abs(qd) / qdd_max).max()),
        machine_still_ms=ms(_standstill_index(samples, at)),
        tcp_speed_mm_s=_speed_mm_s(samples, at - 1, machine),
        tcp_travel_mm=_travel_mm([here.q_rad, last.q_rad], machine),
        void_ms=ms(_first_state_index(samples, at, lambda state: state == "DISARMED")),
        faulted=_first_state_index(samples, at, lambda state: state in _TAKEN_AWAY) is not None,
        resumed=rest is not None and _first_state_index(samples, rest, lambda state: state == "RUN") is not None,
    )


def _first_state_index(samples: Sequence[PlcSample], since: int, wanted: Callable[[str], bool]) -> int | None:
    return next((i for i in range(since, len(samples)) if wanted(samples[i].plc_state)), None)


def _standstill_index(samples: Sequence[PlcSample], since: int) -> int | None:
    """Index of the first state after which no joint moves any more."""
    moving = [
        i for i in range(since, len(samples)) if max(abs(v) for v in samples[i].qd_rad_s) > STANDSTILL_SPEED_MAX_RAD_S
    ]
    last = moving[-1] if moving else since
    return last + 1 if last + 1 < len(samples) else None


def _travel_mm(joints: Sequence[tuple[float, ...]], machine: Machine) -> float:
    points = tcp_poses(chain_of(machine), np.array(joints))[:, :3, 3]
    return 1e3 * float(np.linalg.norm(points[-1] - points[0]))


def _speed_mm_s(samples: Sequence[PlcSample], here: int, machine: Machine) -> float:
    """TCP speed over the five states before."""
    before = samples[max(here - 5, 0)]
    dt_s = (samples[here].t_plc_ns - before.t_plc_ns) * 1e-9
    if dt_s <= 0.0:
        return float("nan")
    return _travel_mm([before.q_rad, samples[here].q_rad], machine) / dt_s
