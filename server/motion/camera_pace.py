"""How fast a calibration path may be driven so that the camera's own trajectory can be followed from pair to pair."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_poses
from server.motion.contracts import JointTrajectory, PathPlan, PlanStatus, evaluate_trajectory, sample_trajectory
from server.motion.refusal import Refusal, refused_plan
from server.motion.settings import DEFAULT_PLAN_SETTINGS, PlanSettings

SAMPLE_PERIOD_S = 0.05


@dataclass(frozen=True, slots=True)
class CameraNeeds:
    """What following the camera and matching its path need.

    shift_max_px: how far a point may be from where the last motion predicts it. focal_px, depth_m: of the scene that is
    followed. chord_m, chords_min: the matching's chords, one from each pair to the first that lies so far ahead.
    """

    shift_max_px: float
    focal_px: float
    depth_m: float
    chord_m: float
    chords_min: int


def camera_paced(
    machine: Machine, plan: PathPlan, pair_s: float, needs: CameraNeeds, settings: PlanSettings = DEFAULT_PLAN_SETTINGS
) -> PathPlan:
    """The plan, driven as slowly as a camera with a pair every `pair_s` needs; refused where that takes too long.

    Model:   constant speed predicts the next pair, its estimate is half an interval old: a point at depth z is off by
             a pair_s^2 f / z pixels, a the largest TCP acceleration. Time stretched by k divides a by k^2. And with a
             pair every `pair_s`, (1 - chord / length) k T / pair_s of them begin a chord.
    Args:    plan: with a trajectory, orientation held. pair_s: time between pairs with the camera's pose [s].
    Returns: the plan itself where it is slow enough; else with all times longer by k.
    """
    if plan.trajectory is None:
        return plan
    acceleration = _acceleration_max(machine, plan.trajectory)
    followed_s = np.sqrt(needs.shift_max_px * needs.depth_m / (needs.focal_px * max(acceleration, 1e-9)))
    chords = (1.0 - needs.chord_m / max(plan.length_m, needs.chord_m)) * plan.duration_s
    counted_s = chords / needs.chords_min
    longer = max(1.0, pair_s / followed_s, pair_s / counted_s if counted_s > 0.0 else np.inf)
    if longer == 1.0:
        return plan
    duration_s = longer * plan.duration_s
    if not duration_s <= settings.duration_max_s:
        text = (
            f"the camera gives a pair every {pair_s:.2f} s; to be followed, this path would take {duration_s:.0f} s "
            f"(limit {settings.duration_max_s:.0f} s, {plan.duration_s:.0f} s from a pair every "
            f"{min(followed_s, counted_s):.2f} s on); relieve the computer, or raise the camera's rate"
        )
        return refused_plan(Refusal(PlanStatus.TOO_FAST, text), plan.q_end, plan.Ts_base_tcp)
    slower = slowed_trajectory(plan.trajectory, longer, settings.knot_s)
    speed_m_s = plan.tcp_speed_max_m_s * plan.trajectory.duration_s / slower.duration_s
    return replace(plan, trajectory=slower, duration_s=slower.duration_s, tcp_speed_max_m_s=speed_m_s)


def slowed_trajectory(trajectory: JointTrajectory, longer: float, knot_s: float) -> JointTrajectory:
    """The same way in at least `longer` times the time; knots `knot_s` apart."""
    t_s = knot_s * np.arange(int(np.ceil(longer * trajectory.duration_s / knot_s)) + 1, dtype=np.float64)
    longer = t_s[-1] / trajectory.duration_s
    motion = evaluate_trajectory(trajectory, t_s / longer)
    for ours, theirs in ((motion.q, trajectory.q), (motion.qd, trajectory.qd), (motion.qdd, trajectory.qdd)):
        ours[[0, -1]] = theirs[[0, -1]]  # at rest to the last bit, as the PLC wants both ends
    return JointTrajectory(t_s, motion.q, motion.qd / longer, motion.qdd / longer**2)


def _acceleration_max(machine: Machine, trajectory: JointTrajectory) -> float:
    """Largest acceleration of the TCP along it [m/s^2]."""
    t_s, motion = sample_trajectory(trajectory, SAMPLE_PERIOD_S)
    if len(t_s) < 3:
        return 0.0
    places = tcp_poses(chain_of(machine), motion.q)[:, :3, 3]
    return float(np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() / (t_s[1] - t_s[0]) ** 2)
