"""The unknowns of the joint estimate, in one vector: small deviations from where they are believed to be.

[ kinematic errors (p) | camera on the TCP (6) | tool marker on the TCP (6) | OOI in the base (6) | odometry's scale |
time offset | lens and prints (7, `joint_lens.py`) ]. Poses deviate by a rotation vector from the left and a
translation, both in the parent's axes.
"""

from dataclasses import dataclass, field

import numpy as np

from machine.poses import inverse_pose, moved_pose, pose_difference
from server.calibration.contracts import Array
from server.calibration.joint_lens import LENS_DERIVATIVE_STEPS, N_LENS
from server.calibration.kinematic_errors import ErrorModel, tcp_poses_with_errors


@dataclass(frozen=True, slots=True)
class JointState:
    """Values of all unknowns."""

    kinematic_errors: Array
    T_tcp_cam: Array
    T_tcp_tool: Array
    T_base_ooi: Array
    odometry_scale: float  # odometry's lengths over true lengths
    time_offset_s: float  # add to the camera's time to get the encoders'
    lens_corrections: Array = field(default_factory=lambda: np.zeros(N_LENS))  # true less the camera file's

    def moved(self, step: Array) -> "JointState":
        """The state further along by `step` (p + 27,)."""
        p = len(self.kinematic_errors)
        rest = step[p:]
        return JointState(
            kinematic_errors=self.kinematic_errors + step[:p],
            T_tcp_cam=moved_pose(self.T_tcp_cam, rest[0:6]),
            T_tcp_tool=moved_pose(self.T_tcp_tool, rest[6:12]),
            T_base_ooi=moved_pose(self.T_base_ooi, rest[12:18]),
            odometry_scale=self.odometry_scale + float(rest[18]),
            time_offset_s=self.time_offset_s + float(rest[19]),
            lens_corrections=self.lens_corrections + rest[20:],
        )

    def step_from(self, believed: "JointState") -> Array:
        """The step (p + 27,) from `believed` to here."""
        poses = [
            pose_difference(believed.T_tcp_cam, self.T_tcp_cam),
            pose_difference(believed.T_tcp_tool, self.T_tcp_tool),
            pose_difference(believed.T_base_ooi, self.T_base_ooi),
        ]
        rest = [self.odometry_scale - believed.odometry_scale, self.time_offset_s - believed.time_offset_s]
        return np.concatenate(
            [
                self.kinematic_errors - believed.kinematic_errors,
                *poses,
                rest,
                self.lens_corrections - believed.lens_corrections,
            ]
        )


def state_steps(model: ErrorModel) -> Array:
    """Steps of all unknowns for numerical derivatives (p + 27,)."""
    six = np.array([1e-5] * 3 + [1e-4] * 3)
    return np.concatenate([model.derivative_steps, six, six, six, [1e-4, 1e-3], LENS_DERIVATIVE_STEPS])


def tool_in_ooi(model: ErrorModel, state: JointState, q: Array, side: Array | None = None) -> Array:
    """T_ooi_tool (4, 4) that the state expects at the joints q (n,) [rad], each on its `side` (n,) of its play."""
    sides = None if side is None else side[None]
    T_base_tool = tcp_poses_with_errors(model, q[None], state.kinematic_errors, sides)[0] @ state.T_tcp_tool
    return inverse_pose(state.T_base_ooi) @ T_base_tool
