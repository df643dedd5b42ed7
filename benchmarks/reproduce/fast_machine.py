"""The machine of a drawn world without oil and inertia: it follows plans, rests short of them, sags and has play."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.reproduce.fast_servo import STEP_S, follow, resting_servo, servo_parameters
from benchmarks.reproduce.fast_structure import Structure
from machine.rotations import Array
from server.jobs.performer import REST_SPEED_RAD_S, REST_WINDOW_S
from server.motion.contracts import JointTrajectory, evaluate_trajectory
from sim_plc.world import World

NOTE_EVERY = 2  # steps: a row of the trace every 10 ms, as often as the PLC sends
SETTLE_MAX_S = 15.0  # as the server's default timeout


@dataclass(frozen=True, slots=True)
class Trace:
    """What happened: times (m,) [s], encoders (m, 6) [rad], true tool poses Ts_base_tcp (m, 4, 4)."""

    t_s: Array
    q_encoder: Array
    Ts_base_tcp: Array

    def since(self, t_s: float) -> "Trace":
        """The rows from a time on."""
        keep = self.t_s >= t_s
        return Trace(self.t_s[keep], self.q_encoder[keep], self.Ts_base_tcp[keep])


class TrueMachine(Protocol):
    """A machine in virtual time."""

    @property
    def t_s(self) -> float:
        """Now [s]."""
        ...

    @property
    def q_ref(self) -> Array:
        """Reference (6,) [rad]."""
        ...

    @property
    def q_encoder(self) -> Array:
        """Encoders (6,) [rad]."""
        ...

    def T_base_tcp(self) -> Array:
        """True pose (4, 4)."""
        ...

    def play(self, trajectory: JointTrajectory) -> None:
        """Follow a trajectory to its last knot."""
        ...

    def settle(self) -> None:
        """Wait until at rest."""
        ...

    def trace(self, t_from_s: float) -> Trace:
        """What happened since."""
        ...


class QuasiStaticMachine:
    """Joints by `fast_servo`, the tool at rest on its springs at every instant. Deterministic."""

    def __init__(self, world: World) -> None:
        self._servo = servo_parameters(world.nominal, world.plant)
        self._state = resting_servo(world.plant, np.asarray(world.q_start_rad, dtype=float))
        self._structure = Structure(world.plant)
        self._resolution = 2.0 * np.pi / world.plant.kinematics.encoder_counts_rev
        self._q_ref = self.q_encoder
        self._steps = 0
        self._rows: list[tuple[Array, Array, Array]] = []

    @property
    def t_s(self) -> float:
        """Now [s]."""
        return self._steps * STEP_S

    @property
    def q_ref(self) -> Array:
        """Reference (6,) [rad]."""
        return self._q_ref.copy()

    @property
    def q_encoder(self) -> Array:
        """Encoders (6,) [rad]."""
        return self._quantised(self._state.q)

    def T_base_tcp(self) -> Array:
        """True pose (4, 4)."""
        return self._structure.tcp_poses(self._state.q, self._state.output)[0]

    def play(self, trajectory: JointTrajectory) -> None:
        """Follow a trajectory to its last knot."""
        n = max(1, int(np.ceil(trajectory.duration_s / STEP_S)))
        reference = evaluate_trajectory(trajectory, STEP_S * np.arange(1, n + 1, dtype=np.float64)).q
        self._follow(reference)
        self._q_ref = trajectory.q[-1].copy()

    def settle(self) -> None:
        """Wait until the encoders rest, as the server judges it."""
        hold = np.tile(self._q_ref, (round(REST_WINDOW_S / STEP_S), 1))
        before = self.q_encoder
        for _ in range(round(SETTLE_MAX_S / REST_WINDOW_S)):
            self._follow(hold)
            now = self.q_encoder
            if np.abs(now - before).max() < REST_SPEED_RAD_S * REST_WINDOW_S:
                return
            before = now

    def trace(self, t_from_s: float) -> Trace:
        """What happened since."""
        if not self._rows:
            return Trace(np.zeros(0), np.zeros((0, 6)), np.zeros((0, 4, 4)))
        t, q, output = (np.concatenate(column) for column in zip(*self._rows, strict=True))
        keep = t >= t_from_s
        return Trace(t[keep], self._quantised(q[keep]), self._structure.tcp_poses(q[keep], output[keep]))

    def _follow(self, reference: Array) -> None:
        q, output = np.empty_like(reference), np.empty_like(reference)
        follow(self._servo, self._state, np.ascontiguousarray(reference), q, output)
        t = STEP_S * (self._steps + np.arange(1, len(reference) + 1, dtype=np.float64))
        self._rows.append((t[::NOTE_EVERY], q[::NOTE_EVERY], output[::NOTE_EVERY]))
        self._steps += len(reference)

    def _quantised(self, q: Array) -> Array:
        return np.round(q / self._resolution) * self._resolution
