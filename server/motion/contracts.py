"""What motion planning hands on: a timed joint trajectory, or a reason why there is none."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class PlanStatus(Enum):
    """How planning ended; only OK may be executed."""

    OK = "ok"
    OUT_OF_REACH = "out_of_reach"
    JOINT_LIMIT = "joint_limit"
    SINGULAR = "singular"
    WALL = "wall"
    OUT_OF_VIEW = "out_of_view"
    TOO_FAST = "too_fast"
    INVALID = "invalid"


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """Knots of the *reference* q_ref(t): times (n,) [s] from 0; positions, rates, accelerations (n, joints) [rad, s].

    Between knots the PLC interpolates with a quintic; first and last knot have zero velocity and acceleration.
    """

    t_s: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def duration_s(self) -> float:
        """Time of the last knot [s]."""
        return float(self.t_s[-1])


@dataclass(frozen=True, slots=True)
class PathPlan:
    """A planned path; `trajectory` is None unless status is OK. `Ts_base_tcp` (m, 4, 4): nominal path, to show."""

    status: PlanStatus
    reason: str
    trajectory: JointTrajectory | None
    Ts_base_tcp: Array
    q_end: Array
    length_m: float
    duration_s: float
    tcp_speed_max_m_s: float
    clearance_m: float  # smallest distance of the tool to the wall along the path; inf if no wall is known
    sigma_min: float  # smallest singular value of the Jacobian along the path
    joint_travel_rad: Array


@dataclass(frozen=True, slots=True)
class Wall:
    """The wall as known: a plane through `point_base` (3,) [m]; `normal_base` (3,) points from it to the machine."""

    point_base: Array
    normal_base: Array
    clearance_min_m: float


# What the PLC makes of knots: quintic interpolation between them; and joining trajectories end to end.


@dataclass(frozen=True, slots=True)
class Motion:
    """Reference at some times: position, velocity, acceleration, each (n, joints) [rad, s]."""

    q: Array
    qd: Array
    qdd: Array


def evaluate_trajectory(trajectory: JointTrajectory, t_s: Array) -> Motion:
    """The reference between the knots, as the PLC interpolates it.

    Model:   on each interval the quintic that meets position, velocity and acceleration at both knots.
    Args:    t_s: times (n,) [s], clipped to the trajectory.
    Returns: position, velocity, acceleration (n, joints).
    """
    knots = trajectory.t_s
    t = np.clip(np.asarray(t_s, dtype=float), knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    h = (knots[i + 1] - knots[i])[:, None]
    x = t[:, None] - knots[i][:, None]
    q0, v0, a0 = trajectory.q[i], trajectory.qd[i], trajectory.qdd[i]
    dq = trajectory.q[i + 1] - q0 - v0 * h - 0.5 * a0 * h**2
    dv = trajectory.qd[i + 1] - v0 - a0 * h
    da = trajectory.qdd[i + 1] - a0
    c3 = (10.0 * dq - 4.0 * dv * h + 0.5 * da * h**2) / h**3
    c4 = (-15.0 * dq + 7.0 * dv * h - da * h**2) / h**4
    c5 = (6.0 * dq - 3.0 * dv * h + 0.5 * da * h**2) / h**5
    return Motion(
        q=q0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5)))),
        qd=v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
        qdd=a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)),
    )


def sample_trajectory(trajectory: JointTrajectory, step_s: float) -> tuple[Array, Motion]:
    """Times (n,) [s] no further apart than `step_s`, both ends included, and the reference there."""
    t = np.linspace(0.0, trajectory.duration_s, max(2, int(np.ceil(trajectory.duration_s / step_s)) + 1))
    return t, evaluate_trajectory(trajectory, t)


def join_trajectories(parts: list[JointTrajectory]) -> JointTrajectory:
    """One trajectory out of parts that each start where the one before ended, at rest."""
    t, q, qd, qdd = [parts[0].t_s], [parts[0].q], [parts[0].qd], [parts[0].qdd]
    end_s = parts[0].duration_s
    for part in parts[1:]:
        t.append(part.t_s[1:] + end_s)
        q.append(part.q[1:])
        qd.append(part.qd[1:])
        qdd.append(part.qdd[1:])
        end_s += part.duration_s
    return JointTrajectory(np.concatenate(t), np.concatenate(q), np.concatenate(qd), np.concatenate(qdd))


def hold_trajectory(q: Array, duration_s: float, knot_s: float) -> JointTrajectory:
    """Standing still at q (joints,) for a while."""
    n = max(2, round(duration_s / knot_s) + 1)
    still = np.zeros((n, len(q)))
    return JointTrajectory(knot_s * np.arange(n, dtype=np.float64), np.tile(q, (n, 1)), still, still.copy())
