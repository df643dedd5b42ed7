"""Time on a joint path: as fast as the limits of joints and TCP allow, for the reference that is really sent."""

from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_poses
from server.motion.contracts import Array, JointTrajectory, PlanStatus
from server.motion.joint_path import JointPath
from server.motion.reference_shaping import servo_lag_of, shaped
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings
from server.motion.time_law import CruiseLaw, QuinticLaw, TimeLaw
from server.motion.trajectory import sample

_ROUNDS = 12


def time_derivatives(path: JointPath, law: TimeLaw, t_s: Array, duration_s: float) -> list[Array]:
    """Planned joints and their first four time derivatives (chain rule through s(t)), each (n, joints)."""
    law_u = law.derivatives(t_s / duration_s, 4)
    s, s1, s2, s3, s4 = (value[:, None] / duration_s**order for order, value in enumerate(law_u))
    q, p1, p2, p3, p4 = path.derivatives(np.clip(s[:, 0], 0.0, 1.0))
    return [
        q,
        p1 * s1,
        p2 * s1**2 + p1 * s2,
        p3 * s1**3 + 3.0 * p2 * s1 * s2 + p1 * s3,
        p4 * s1**4 + 6.0 * p3 * s1**2 * s2 + p2 * (3.0 * s2**2 + 4.0 * s1 * s3) + p1 * s4,
    ]


@dataclass(frozen=True, slots=True)
class Pace:
    """Duration without ramps at even speed, and the ramp on top, both [s]; the plain quintic has no ramp of its own."""

    even_s: float
    ramp_s: float
    shaped: bool

    @property
    def duration_s(self) -> float:
        """Time from rest to rest [s]."""
        if not self.shaped:
            return QuinticLaw().peak * self.even_s
        return max(self.even_s + self.ramp_s, 2.0 * self.even_s)

    def law(self, duration_s: float) -> TimeLaw:
        """The paper's quintic, or ramps and an even speed when the reference is shaped."""
        return CruiseLaw(min(0.5, self.ramp_s / duration_s)) if self.shaped else QuinticLaw()

    def slower(self, speed: float, acceleration: float) -> "Pace":
        """The pace that undoes an excess of speed and of (the root of) acceleration."""
        if not self.shaped:
            factor = max(speed, acceleration, 1.0)
            return replace(self, even_s=self.even_s * factor)
        ramp = self.ramp_s * max(acceleration, 1.0)
        even = self.even_s * max(speed, 1.0)
        if self.ramp_s >= self.even_s and speed > 1.0:  # no even part: only longer ramps are slower
            ramp = max(ramp, self.ramp_s * speed)
        return replace(self, even_s=even, ramp_s=ramp)


def _knots(
    machine: Machine, path: JointPath, law: TimeLaw, duration_s: float, settings: PlanSettings
) -> JointTrajectory:
    t = settings.knot_s * np.arange(round(duration_s / settings.knot_s) + 1, dtype=np.float64)
    planned = time_derivatives(path, law, t, float(t[-1]))
    q, qd, qdd = shaped(planned, servo_lag_of(machine)) if settings.shape_reference else planned[:3]
    for rates in (qd, qdd):
        rates[0], rates[-1] = 0.0, 0.0
    q[0], q[-1] = path.qs[0], path.qs[-1]
    return JointTrajectory(t, q, qd, qdd)


def tcp_speed(chain: Chain, trajectory: JointTrajectory, step_s: float = 0.025) -> float:
    """Largest speed of the TCP along the reference [m/s]."""
    t, motion = sample(trajectory, step_s)
    points = tcp_poses(chain, motion.q)[:, :3, 3]
    return float((np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t)).max())


@dataclass(frozen=True, slots=True)
class Excess:
    """How much too fast a trajectory is: factors of time by speed and by acceleration (<= 1: obeys), and the worst."""

    speed: float
    acceleration: float
    worst: str


def excess(machine: Machine, chain: Chain, trajectory: JointTrajectory, settings: PlanSettings) -> Excess:
    """How the reference compares with the limits of joints and TCP, between the knots too."""
    _, motion = sample(trajectory, 0.01)
    share, scale = settings.limit_share, settings.speed_scale
    v_max = np.array([joint.qd_max_rad_s for joint in machine.joints]) * share * scale
    a_max = np.array([joint.qdd_max_rad_s2 for joint in machine.joints]) * share
    v, a = np.abs(motion.qd).max(axis=0) / v_max, np.sqrt(np.abs(motion.qdd).max(axis=0) / a_max)
    tcp = tcp_speed(chain, trajectory) / (machine.tcp_speed_max_m_s * share * scale)
    candidates = (
        (float(v.max()), f"speed of joint '{machine.joints[int(v.argmax())].name}'"),
        (float(a.max()), f"acceleration of joint '{machine.joints[int(a.argmax())].name}'"),
        (tcp, "speed of the TCP"),
    )
    return Excess(max(float(v.max()), tcp), float(a.max()), max(candidates)[1])


def time_path(machine: Machine, chain: Chain, path: JointPath, settings: PlanSettings) -> JointTrajectory | Refusal:
    """Shortest rest-to-rest trajectory along the path that obeys all limits between the knots too.

    Model:   the pace slows by the excess of |qd|, sqrt |qdd| and TCP speed of the (shaped) reference until there is
             none.
    Returns: knots on the settings' grid, the first exactly where the path starts; or TOO_FAST when the longest
             duration is not enough.
    """
    scale = settings.speed_scale
    even_s = max(
        path.length_m / (machine.tcp_speed_max_m_s * settings.limit_share * scale),
        path.turn_rad / (settings.turn_speed_max_rad_s * scale),
        0.05,
    )
    pace = Pace(even_s, settings.ramp_s, settings.shape_reference)
    worst = "speed of the TCP"
    for _ in range(_ROUNDS):
        duration = max(pace.duration_s, settings.duration_min_s)
        duration = settings.knot_s * float(np.ceil(duration / settings.knot_s - 1e-9))
        if duration > settings.duration_max_s:
            break
        trajectory = _knots(machine, path, pace.law(duration), duration, settings)
        over = excess(machine, chain, trajectory, settings)
        if max(over.speed, over.acceleration) <= 1.0:
            return trajectory
        pace, worst = pace.slower(1.02 * over.speed, 1.02 * over.acceleration), over.worst
    text = (
        f"{worst} asks for {pace.duration_s:.0f} s, limit {settings.duration_max_s:.0f} s; "
        f"move in shorter steps or raise the speed scale ({settings.speed_scale:.2f})"
    )
    return Refusal(PlanStatus.TOO_FAST, text)
