"""From the joint estimate to joints: where the encoders must be for the tool to be at its goal, and how sure it is."""

from dataclasses import dataclass

import numpy as np

from machine.chain import Chain
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import pose_difference
from machine.rotations import rotation_from_rotvec, rotvec_from_rotation, skew
from server.calibration.contracts import Array
from server.calibration.joint_estimate import JointEstimate
from server.calibration.joint_observations import NoiseModel
from server.calibration.joint_state import JointState, state_steps, tool_in_ooi
from server.calibration.kinematic_errors import ErrorModel
from server.calibration.nuisances import (
    CLOCK,
    LAYOUT,
    MACHINE,
    MARKER,
    MOUNT,
    REST,
    SCALE,
    Contribution,
    contributions_by_group,
    lens_groups,
)

ITERATIONS_MAX = 12
CLOSE_M, CLOSE_RAD = 1e-6, 1e-7


@dataclass(frozen=True, slots=True)
class JointGoal:
    """Joints (n,) [rad] of the encoders, or None with the reason; T_base_tcp is the nominal pose there.

    `covariance` (6, 6): of tool minus goal after the move, OOI axes: rotation vector [rad], then position [m].
    `contributions`: what adds how much to its position.
    """

    q: Array | None
    reason: str
    T_base_tcp: Array | None
    covariance: Array | None
    contributions: tuple[Contribution, ...] = ()


def joints_for_goal(
    chain: Chain,
    estimate: JointEstimate,
    q_now: Array,
    T_ooi_goal: Array,
    noise: NoiseModel | None = None,
    side: Array | None = None,
) -> JointGoal:
    """Where to go.

    Model:   T_ooi_tool(q; x) of the estimate equals T_ooi_goal; solved by correcting the nominal pose by what the
             model still leaves and taking its closed-form inverse, which converges by the ratio of the errors (a few
             per cent a round).
    Args:    q_now: encoders (n,) [rad]. T_ooi_goal: wanted pose of the tool (4, 4). side: of its play from which each
             joint will come there (n,).
    Returns: joints and the predicted covariance of the error there, play between encoders and tool included.
    Raises:  ValueError: the estimate is not OK.
    """
    if estimate.state is None or estimate.covariance is None:
        raise ValueError(f"joint estimate is {estimate.status.value}: {estimate.reason}")
    model, state = estimate.error_model, estimate.state
    q = q_now
    T_nominal = tcp_pose(chain, q_now)
    for _ in range(ITERATIONS_MAX):
        shift, turn = _goal_error_in_base(model, state, q, T_ooi_goal, side)
        if np.linalg.norm(shift) < CLOSE_M and np.linalg.norm(turn) < CLOSE_RAD:
            break
        T_nominal = _corrected_tcp_pose(T_nominal, shift, turn, state)
        found = inverse_nearest(chain, T_nominal, q)
        if found.q_rad is None:
            return JointGoal(None, found.reason, T_nominal, None)
        q = found.q_rad
    else:
        return JointGoal(None, "the corrected goal does not converge; retract and calibrate again", T_nominal, None)
    covariance, found = goal_covariance(estimate, q, noise or estimate.noise_model, side)
    return JointGoal(q, "", tcp_pose(chain, q), covariance, found)


def _goal_error_in_base(
    model: ErrorModel, state: JointState, q: Array, T_ooi_goal: Array, side: Array | None
) -> tuple[Array, Array]:
    """Goal minus tool in base axes: position of the tool marker [m], rotation vector [rad]."""
    T_ooi_tool = tool_in_ooi(model, state, q, side)
    R = state.T_base_ooi[:3, :3]
    turn = rotvec_from_rotation(T_ooi_goal[:3, :3] @ T_ooi_tool[:3, :3].T)
    return R @ (T_ooi_goal[:3, 3] - T_ooi_tool[:3, 3]), R @ turn


def _corrected_tcp_pose(T_base_tcp: Array, shift: Array, turn: Array, state: JointState) -> Array:
    """The nominal TCP pose, turned about the tool marker and shifted."""
    lever = T_base_tcp[:3, :3] @ state.T_tcp_tool[:3, 3]
    T = np.eye(4)
    T[:3, :3] = rotation_from_rotvec(turn) @ T_base_tcp[:3, :3]
    T[:3, 3] = T_base_tcp[:3, 3] + lever + shift - T[:3, :3] @ state.T_tcp_tool[:3, 3]
    return T


def goal_covariance(
    estimate: JointEstimate, q: Array, noise: NoiseModel, side: Array | None = None
) -> tuple[Array, tuple[Contribution, ...]]:
    """Covariance (6, 6) of T_ooi_tool at the joints q, OOI axes, and what contributes to its position.

    What is not known, where joints come to rest, and where the OOI's markers hang.
    """
    model, state, covariance = estimate.error_model, estimate.state, estimate.covariance
    if state is None or covariance is None:
        raise ValueError(f"joint estimate is {estimate.status.value}: {estimate.reason}")
    here = tool_in_ooi(model, state, q, side)
    steps = state_steps(model)
    columns = [
        pose_difference(here, tool_in_ooi(model, state.moved(step), q, side)) / h
        for step, h in zip(np.diag(steps), steps, strict=True)
    ]
    J = np.column_stack(columns)
    step = 1e-5
    Jq = np.column_stack(
        [
            pose_difference(here, tool_in_ooi(model, state, q + step * (np.arange(len(q)) == j), side)) / step
            for j in range(len(q))
        ]
    )
    play = np.resize(np.array(noise.sigma_joint_rad), len(q))
    rest, layout = (Jq * play**2) @ Jq.T, _of_layout(estimate, here)
    C = J @ covariance @ J.T + rest + layout
    found = contributions_by_group(J[3:], covariance, _unknowns_by_source(model.n))
    others = [Contribution(name, np.diag(part)[3:]) for name, part in ((REST, rest), (LAYOUT, layout))]
    return 0.5 * (C + C.T), (*found, *others)


def _unknowns_by_source(p: int) -> dict[str, list[int]]:
    """Unknowns of the joint state by source, p of them kinematic; the OOI's place is what the looks make of these."""
    named = {MACHINE: range(p), MOUNT: range(p, p + 6), MARKER: range(p + 6, p + 12), SCALE: [p + 18], CLOCK: [p + 19]}
    return {**{name: list(indices) for name, indices in named.items() if len(indices)}, **lens_groups(p + 20)}


def _of_layout(estimate: JointEstimate, T_ooi_tool: Array) -> Array:
    """Covariance (6, 6) of the tool in the OOI's own axes: all that was seen of the OOI is its markers."""
    if estimate.layout_covariance is None:
        return np.zeros((6, 6))
    A = np.eye(6)
    A[3:, :3] = -skew(T_ooi_tool[:3, 3])
    return A @ estimate.layout_covariance @ A.T
