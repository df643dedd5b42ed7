"""The same machine with everything: the fine plant under the PLC's own joint control, in virtual time. Slow."""

import numpy as np

from benchmarks.reproduce.fast_machine import SETTLE_MAX_S, Trace
from machine.rotations import Array
from server.jobs.performer import REST_SPEED_RAD_S, REST_WINDOW_S
from server.motion.contracts import JointTrajectory, evaluate_trajectory
from sim_plc.plant.plant import Plant
from sim_plc.plc.settings import plc_settings
from sim_plc.plc.status import JointControl
from sim_plc.world import World

NOTE_EVERY_MS = 10
REST_WINDOW_MS = round(1e3 * REST_WINDOW_S)


class NotAtRestError(RuntimeError):
    """The machine still moves after the settle timeout."""


class FineMachine:
    """Plant and joint control cycle by cycle; links and datagrams are left out. Deterministic."""

    def __init__(self, world: World) -> None:
        self._plant = Plant(world.plant, world.q_start_rad)
        self._settings = plc_settings(world.nominal)
        self._control = JointControl(self._settings)
        self._q_ref = self._plant.q_encoder_rad
        self._valves = np.zeros(6)
        self._ms = 0
        self._rows: list[tuple[float, Array, Array]] = []

    @property
    def t_s(self) -> float:
        """Now [s]."""
        return 1e-3 * self._ms

    @property
    def q_ref(self) -> Array:
        """Reference (6,) [rad]."""
        return self._q_ref.copy()

    @property
    def q_encoder(self) -> Array:
        """Encoders (6,) [rad]."""
        return self._plant.q_encoder_rad

    def T_base_tcp(self) -> Array:
        """True pose (4, 4)."""
        return self._plant.T_base_tcp()

    def play(self, trajectory: JointTrajectory) -> None:
        """Follow a trajectory to its last knot."""
        n = max(1, int(np.ceil(trajectory.duration_s * 1e3)))
        self._follow(evaluate_trajectory(trajectory, 1e-3 * np.arange(1, n + 1, dtype=np.float64)).q)
        self._q_ref = trajectory.q[-1].copy()

    def settle(self) -> None:
        """Wait until the encoders rest.

        Raises: NotAtRestError after 15 s.
        """
        before = self.q_encoder
        for _ in range(round(SETTLE_MAX_S / REST_WINDOW_S)):
            self._follow(np.tile(self._q_ref, (REST_WINDOW_MS, 1)))
            now = self.q_encoder
            if np.abs(now - before).max() < REST_SPEED_RAD_S * REST_WINDOW_S:
                return
            before = now
        raise NotAtRestError(f"encoders still move after {SETTLE_MAX_S:.0f} s; look for a limit cycle")

    def trace(self, t_from_s: float) -> Trace:
        """What happened since."""
        rows = [row for row in self._rows if row[0] >= t_from_s]
        if not rows:
            return Trace(np.zeros(0), np.zeros((0, 6)), np.zeros((0, 4, 4)))
        t, q, Ts = zip(*rows, strict=True)
        return Trace(np.array(t), np.array(q), np.array(Ts))

    def _follow(self, reference: Array) -> None:
        plant = self._plant
        for q_ref in reference:
            self._valves = self._control.control(q_ref, plant.q_encoder_rad, 1.0)
            plant.step(self._valves)
            self._ms += 1
            if self._ms % NOTE_EVERY_MS == 0:
                self._rows.append((self.t_s, plant.q_encoder_rad, plant.T_base_tcp()))
