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
    """Duration at even speed alone, and the ramp on top, both [s]; the plain quintic has no ramp of its own."""

    even_s: float
    ramp_s: float
    shaped: bool

    @property
    def duration_s(self) -> float:
        """Time from rest to rest [s]."""
        if not self.shaped:
            return QuinticLaw().peak * self.even_s
        return self.even_s + self.ramp_s

    def law(self, duration_s: float) -> TimeLaw:
        """The paper's quintic, or ramps and an even speed when the reference is shaped."""
        return CruiseLaw(min(0.5, self.ramp_s / duration_s)) if self.shaped else QuinticLaw()

    def slower(self, planned: float, reference: float) -> "Pace":
        """The pace that undoes an excess of the planned motion (less speed) and of the reference (softer ramps)."""
        if not self.shaped:
            return replace(self, even_s=self.even_s * max(planned, reference, 1.0))
        return replace(self, even_s=self.even_s * max(planned, 1.0), ramp_s=self.ramp_s * max(reference, 1.0))


def _knots(
    machine: Machine, path: JointPath, law: TimeLaw, duration_s: float, settings: PlanSettings
) -> tuple[JointTrajectory, JointTrajectory]:
    """Knots of the planned motion, and of the reference that asks for it."""
    t = settings.knot_s * np.arange(round(duration_s / settings.knot_s) + 1, dtype=np.float64)
    planned = time_derivatives(path, law, t, float(t[-1]))
    motion = JointTrajectory(t, *planned[:3])
    q, qd, qdd = shaped(planned, servo_lag_of(machine)) if settings.shape_reference else planned[:3]
    reference = JointTrajectory(t, q.copy(), qd.copy(), qdd.copy())
    for rates in (reference.qd, reference.qdd):
        rates[0], rates[-1] = 0.0, 0.0
    reference.q[0], reference.q[-1] = path.qs[0], path.qs[-1]
    return motion, reference


def tcp_speed(chain: Chain, trajectory: JointTrajectory, step_s: float = 0.025) -> float:
    """Largest speed of the TCP along a trajectory [m/s]."""
    t, motion = sample(trajectory, step_s)
    points = tcp_poses(chain, motion.q)[:, :3, 3]
    return float((np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t)).max())


@dataclass(frozen=True, slots=True)
class Excess:
    """By what factor of time a trajectory is too fast (<= 1: it obeys), and which limit asks for it most."""

    factor: float
    worst: str


def excess(
    machine: Machine, chain: Chain, trajectory: JointTrajectory, settings: PlanSettings, tcp_share: float
) -> Excess:
    """How a trajectory compares with the limits of joints and TCP, between the knots too.

    Args:    tcp_share: of the machine's TCP speed limit.
    """
    _, motion = sample(trajectory, 0.01)
    share, scale = settings.limit_share, settings.speed_scale
    v_max = np.array([joint.qd_max_rad_s for joint in machine.joints]) * share * scale
    a_max = np.array([joint.qdd_max_rad_s2 for joint in machine.joints]) * share
    v, a = np.abs(motion.qd).max(axis=0) / v_max, np.sqrt(np.abs(motion.qdd).max(axis=0) / a_max)
    candidates = (
        (float(v.max()), f"speed of joint '{machine.joints[int(v.argmax())].name}'"),
        (float(a.max()), f"acceleration of joint '{machine.joints[int(a.argmax())].name}'"),
        (tcp_speed(chain, trajectory) / (machine.tcp_speed_max_m_s * tcp_share * scale), "speed of the TCP"),
    )
    return Excess(*max(candidates))


@dataclass(frozen=True, slots=True)
class Timed:
    """The reference to send, and the fastest that the TCP is planned to move with it [m/s]."""

    reference: JointTrajectory
    tcp_speed_m_s: float


def time_path(machine: Machine, chain: Chain, path: JointPath, settings: PlanSettings) -> Timed | Refusal:
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
        motion, reference = _knots(machine, path, pace.law(duration), duration, settings)
        planned = excess(machine, chain, motion, settings, settings.limit_share)
        sent = excess(machine, chain, reference, settings, settings.reference_tcp_share)
        if max(planned.factor, sent.factor) <= 1.0:
            return Timed(reference, tcp_speed(chain, motion))
        pace = pace.slower(1.02 * planned.factor, 1.02 * sent.factor)
        worst = max(planned, sent, key=lambda each: each.factor).worst
    text = (
        f"{worst} asks for {pace.duration_s:.0f} s, limit {settings.duration_max_s:.0f} s; "
        f"move in shorter steps or raise the speed scale ({settings.speed_scale:.2f})"
    )
    return Refusal(PlanStatus.TOO_FAST, text)
