"""Time on a joint path: as fast as the limits of joints and TCP allow, for the reference that is really sent."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_poses
from server.motion.contracts import Array, JointTrajectory, PlanStatus, sample_trajectory
from server.motion.joint_path import JointPath
from server.motion.refusal import Refusal
from server.motion.settings import PlanSettings

_ROUNDS = 12


# Time laws: how the share of a path already covered grows with time, from rest to rest.


class TimeLaw(Protocol):
    """s(u) with u = t / T in 0..1, s(0) = 0, s(1) = 1, at rest at both ends."""

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        ...

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class QuinticLaw:
    """The paper's point-to-point law 10 u^3 - 15 u^4 + 6 u^5: zero velocity and acceleration at both ends."""

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        return 15.0 / 8.0

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        s = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
        return [s(u), *(s.deriv(order)(u) for order in range(1, highest + 1))]


@dataclass(frozen=True, slots=True)
class CruiseLaw:
    """Even speed between two smooth ramps; zero up to the fourth derivative at both ends.

    Model:   ds/du = V S(u / r) on the ramp, S(x) = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7, V = 1 / (1 - r); mirrored at the
             end. A reference shaped through two lags needs four vanishing derivatives to start and end smoothly.
    Args:    ramp_frac: r, share of the duration that each ramp takes, 0 < r <= 0.5.
    """

    ramp_frac: float

    @property
    def peak(self) -> float:
        """Largest ds/du."""
        return 1.0 / (1.0 - self.ramp_frac)

    def derivatives(self, u: Array, highest: int) -> list[Array]:
        """s and its derivatives with respect to u, up to order `highest`, at u (n,)."""
        r, V = self.ramp_frac, self.peak
        late = u > 0.5  # the second half is the first one turned about its middle: s(u) = 1 - s(1 - u)
        x = np.minimum(np.where(late, 1.0 - u, u) / r, 1.0)
        ramp = Polynomial([0.0, 0.0, 0.0, 0.0, 0.0, 7.0, -14.0, 10.0, -2.5]) * r * V
        first = ramp(x) + V * np.maximum(np.where(late, 1.0 - u, u) - r, 0.0)
        result = [np.where(late, 1.0 - first, first)]
        for order in range(1, highest + 1):
            value = ramp.deriv(order)(x) / r**order
            result.append(np.where(late, (-1.0) ** (order + 1) * value, value))
        return result


# Reference shaping: what to ask of a lagging P or PT-1 joint so that the joint itself follows the planned path.


@dataclass(frozen=True, slots=True)
class ServoLag:
    """Nominal joint loops: qd = gain (q_ref - q) behind a first-order lag tau. Shapes (joints,), [1/s] and [s]."""

    gain: Array
    tau_s: Array


def servo_lag_of(machine: Machine) -> ServoLag:
    """The nominal loops of a machine: gain = kp velocity_gain, tau of the PT-1 joints (eq. 25)."""
    gain = np.array([joint.kp_frac_per_rad * joint.velocity_gain_rad_s for joint in machine.joints])
    return ServoLag(gain=gain, tau_s=np.array([joint.pt1_tau_s for joint in machine.joints]))


def lag_compensated(derivatives: list[Array], lag: ServoLag) -> list[Array]:
    """Reference whose lagging response is the planned path.

    Model:   u = kp (q_ref - q) / (tau s + 1), qd = velocity_gain u  =>  q_ref = q + (qd + tau qdd) / (kp
             velocity_gain).
    Args:    derivatives: planned q and its first four time derivatives, each (n, joints).
    Returns: q_ref and its first two time derivatives, each (n, joints); equal to q wherever the first four vanish.
    Source:  Makinen et al. 2023, eq. 6 and 25, inverted.
    """
    q, q1, q2, q3, q4 = derivatives
    return [
        q + (q1 + lag.tau_s * q2) / lag.gain,
        q1 + (q2 + lag.tau_s * q3) / lag.gain,
        q2 + (q3 + lag.tau_s * q4) / lag.gain,
    ]


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
    reference_shaped: bool

    @property
    def duration_s(self) -> float:
        """Time from rest to rest [s]."""
        if not self.reference_shaped:
            return QuinticLaw().peak * self.even_s
        return self.even_s + self.ramp_s

    def time_law(self, duration_s: float) -> TimeLaw:
        """The paper's quintic, or ramps and an even speed when the reference is shaped."""
        return CruiseLaw(min(0.5, self.ramp_s / duration_s)) if self.reference_shaped else QuinticLaw()

    def slowed(self, planned: float, reference: float) -> "Pace":
        """The pace that undoes an excess of the planned motion (less speed) and of the reference (softer ramps)."""
        if not self.reference_shaped:
            return replace(self, even_s=self.even_s * max(planned, reference, 1.0))
        return replace(self, even_s=self.even_s * max(planned, 1.0), ramp_s=self.ramp_s * max(reference, 1.0))


def _motion_and_reference_knots(
    machine: Machine, path: JointPath, law: TimeLaw, duration_s: float, settings: PlanSettings
) -> tuple[JointTrajectory, JointTrajectory]:
    """Knots of the planned motion, and of the reference that asks for it."""
    t = settings.knot_s * np.arange(round(duration_s / settings.knot_s) + 1, dtype=np.float64)
    planned = time_derivatives(path, law, t, float(t[-1]))
    motion = JointTrajectory(t, *planned[:3])
    q, qd, qdd = lag_compensated(planned, servo_lag_of(machine)) if settings.shape_reference else planned[:3]
    reference = JointTrajectory(t, q.copy(), qd.copy(), qdd.copy())
    for rates in (reference.qd, reference.qdd):
        rates[0], rates[-1] = 0.0, 0.0
    reference.q[0], reference.q[-1] = path.qs[0], path.qs[-1]
    return motion, reference


def tcp_speed(chain: Chain, trajectory: JointTrajectory, step_s: float = 0.025) -> float:
    """Largest speed of the TCP along a trajectory [m/s]."""
    t, motion = sample_trajectory(trajectory, step_s)
    points = tcp_poses(chain, motion.q)[:, :3, 3]
    return float((np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t)).max())


@dataclass(frozen=True, slots=True)
class Excess:
    """By what factor of time a trajectory is too fast (<= 1: it obeys), and which limit asks for it most."""

    time_factor: float
    limiting_quantity: str


def limit_excess(
    machine: Machine, chain: Chain, trajectory: JointTrajectory, settings: PlanSettings, tcp_share: float
) -> Excess:
    """How a trajectory compares with the limits of joints and TCP, between the knots too.

    Args:    tcp_share: of the machine's TCP speed limit.
    """
    _, motion = sample_trajectory(trajectory, 0.01)
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
class TimedPath:
    """The reference to send, and the fastest that the TCP is planned to move with it [m/s]."""

    reference: JointTrajectory
    tcp_speed_m_s: float


def time_path(machine: Machine, chain: Chain, path: JointPath, settings: PlanSettings) -> TimedPath | Refusal:
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
        motion, reference = _motion_and_reference_knots(machine, path, pace.time_law(duration), duration, settings)
        planned = limit_excess(machine, chain, motion, settings, settings.limit_share)
        sent = limit_excess(machine, chain, reference, settings, settings.reference_tcp_share)
        if max(planned.time_factor, sent.time_factor) <= 1.0:
            return TimedPath(reference, tcp_speed(chain, motion))
        pace = pace.slowed(1.02 * planned.time_factor, 1.02 * sent.time_factor)
        worst = max(planned, sent, key=lambda each: each.time_factor).limiting_quantity
    text = (
        f"{worst} asks for {pace.duration_s:.0f} s, limit {settings.duration_max_s:.0f} s; "
        f"move in shorter steps or raise the speed scale ({settings.speed_scale:.2f})"
    )
    return Refusal(PlanStatus.TOO_FAST, text)
