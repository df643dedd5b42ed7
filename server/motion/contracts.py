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
