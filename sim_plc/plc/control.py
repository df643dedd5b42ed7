"""The paper's joint controllers: P (eq. 6), and PT-1 (eq. 25) on the joints that carry the weight."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from machine.description import Joint


@dataclass(slots=True)
class JointControllers:
    """u = kp (q_ref - q), followed by 1 / (tau s + 1) where tau > 0, clipped to -1..1; zero-order hold over the cycle."""

    joints: tuple[Joint, ...]
    cycle_s: float
    _lagged: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the PT-1 states: as at rest on the reference."""
        self._lagged = [0.0] * len(self.joints)

    def valves(self, q_ref: Sequence[float], q: Sequence[float]) -> list[float]:
        """Valve commands, fraction of full command."""
        commands = []
        for i, joint in enumerate(self.joints):
            u = joint.kp_frac_per_rad * (q_ref[i] - q[i])  # eq. 6
            if joint.pt1_tau_s > 0.0:
                share = self.cycle_s / (joint.pt1_tau_s + self.cycle_s)  # eq. 25, implicit Euler
                self._lagged[i] += share * (u - self._lagged[i])
                u = self._lagged[i]
            commands.append(min(1.0, max(-1.0, u)))
        return commands
