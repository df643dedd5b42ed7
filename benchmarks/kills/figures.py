"""What one kill did, from the PLC's states alone: when the ramp started, how long it took, how far the tool went."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.chain import Chain, chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose
from machine.rotations import Array
from protocol.codes import PlcState
from protocol.messages import State

STILL_RAD_S = 0.003  # encoders: the boom has stopped swinging
_BEFORE = 60  # states before the ramp that are looked at: more than the 250 ms of silence


@dataclass(frozen=True, slots=True)
class KillFigures:
    """One kill. Times count from the last command that the PLC accepted, on its clock."""

    ramp_start_ms: float
    reference_at_rest_ms: float
    ramp_ms: float
    ramp_bound_ms: float  # max |qd| / qdd_stop at the start of the ramp, of the reference and of the joints behind it
    machine_still_ms: float
    tcp_speed_mm_s: float  # when the ramp started
    tcp_travel_mm: float  # from the last command to standstill, by encoders and nominal kinematics
    tcp_ramp_mm: float  # of it from the start of the ramp
    reference_travel_mm: float  # from the last command to rest, of the reference


def figures_of(states: Sequence[State], machine: Machine) -> KillFigures:
    """The figures from the PLC's states of the newest stop: RUN, STOPPING, HOLD.

    The state comes every 10 ms; the start of the ramp is where the reference's speed before and in the ramp, both taken
    as straight lines over two states, meet. The end is the first state at rest: up to 10 ms late.

    Raises: ValueError: the motion was not interrupted.
    """
    chain, n = chain_of(machine), len(machine.joints)
    first = max(i for i, state in enumerate(states) if state.plc_state is PlcState.RUN) + 1
    ramp = states[first]
    if ramp.plc_state is not PlcState.STOPPING:
        raise ValueError(f"after RUN came {ramp.plc_state.name}: the trajectory had ended before the kill")
    rest = next(state for state in states[first:] if state.plc_state is not PlcState.STOPPING)
    qdd_stop = np.array([joint.qdd_max_rad_s2 for joint in machine.joints])
    joint = int(np.argmax(np.abs(ramp.qd_ref[:n]) / qdd_stop))
    t_ramp_ns = _meeting_ns(states[first - 2 : first + 2], joint)
    t_command_ns = states[first - 1].t_send_ns - states[first - 1].rx_age_us * 1000
    last = states[first - 1]  # towards a path's end the reference slows down before the joints that lag behind it
    speed = np.maximum(np.abs(np.array(last.qd_ref[:n])), np.abs(np.array(last.qd[:n])))
    seen = states[max(0, first - _BEFORE) :]
    times = np.array([state.t_send_ns for state in seen])
    path = _points(chain, [state.q[:n] for state in seen])
    reference = _points(chain, [state.q_ref[:n] for state in seen])
    moving = [state.t_send_ns for state in states[first:] if np.abs(state.qd[:n]).max() > STILL_RAD_S]
    i_command, i_ramp, i_rest = (int(np.searchsorted(times, t)) for t in (t_command_ns, t_ramp_ns, rest.t_send_ns))
    return KillFigures(
        ramp_start_ms=(t_ramp_ns - t_command_ns) / 1e6,
        reference_at_rest_ms=(rest.t_send_ns - t_command_ns) / 1e6,
        ramp_ms=(rest.t_send_ns - t_ramp_ns) / 1e6,
        ramp_bound_ms=float((speed / qdd_stop).max()) * 1e3,
        machine_still_ms=(max(moving, default=rest.t_send_ns) - t_command_ns) / 1e6,
        tcp_speed_mm_s=float(
            np.linalg.norm(path[i_ramp] - path[i_ramp - 3]) / (times[i_ramp] - times[i_ramp - 3]) * 1e12
        ),
        tcp_travel_mm=float(np.linalg.norm(path[-1] - path[i_command])) * 1e3,
        tcp_ramp_mm=float(np.linalg.norm(path[-1] - path[i_ramp])) * 1e3,
        reference_travel_mm=float(np.linalg.norm(reference[i_rest] - reference[i_command])) * 1e3,
    )


def _points(chain: Chain, joints: list[tuple[float, ...]]) -> Array:
    return np.array([tcp_pose(chain, np.array(q))[:3, 3] for q in joints])


def _meeting_ns(four: Sequence[State], joint: int) -> int:
    """Where the lines through the first and the last two speeds of a joint meet, between the middle two."""
    t = np.array([state.t_send_ns - four[1].t_send_ns for state in four], dtype=float)
    v = np.array([state.qd_ref[joint] for state in four])
    slope_run, slope_ramp = (v[1] - v[0]) / (t[1] - t[0]), (v[3] - v[2]) / (t[3] - t[2])
    if slope_run == slope_ramp:
        return four[2].t_send_ns
    meeting = (v[2] - slope_ramp * t[2] - v[1]) / (slope_run - slope_ramp)
    return four[1].t_send_ns + round(min(max(meeting, t[1]), t[2]))


def largest_step(states: Sequence[State], machine: Machine) -> float:
    """Largest change of any joint's qd_ref between two states, as a share of qdd_max times the time between them."""
    n = len(machine.joints)
    if len(states) < 2:
        return 0.0
    qdd_max = np.array([joint.qdd_max_rad_s2 for joint in machine.joints])
    qd_ref = np.array([state.qd_ref[:n] for state in states])
    dt_s = np.diff(np.array([state.t_send_ns for state in states])) * 1e-9
    return float((np.abs(np.diff(qd_ref, axis=0)) / (qdd_max * dt_s[:, None])).max())


def figures_table(figures: Sequence[KillFigures]) -> str:
    """A table in Markdown."""
    head = (
        "| kill | ramp starts ms | reference at rest ms | ramp ms | bound ms | still ms "
        "| TCP mm/s | TCP travel mm | from ramp on mm |"
    )
    rows = [
        f"| {i} | {f.ramp_start_ms:.0f} | {f.reference_at_rest_ms:.0f} | {f.ramp_ms:.0f} | {f.ramp_bound_ms:.0f} "
        f"| {f.machine_still_ms:.0f} | {f.tcp_speed_mm_s:.0f} | {f.tcp_travel_mm:.1f} | {f.tcp_ramp_mm:.1f} |"
        for i, f in enumerate(figures, start=1)
    ]
    return "\n".join([head, "|" + "---|" * 9, *rows])
