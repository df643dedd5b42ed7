"""Set-ups of the foreign plant drawn at random: a fault of it or none, how it was logged, and what nobody logged."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from foreign_plant import KINDS, OFFSET_S, Fault, rewritten, write

Named = list[tuple[str, int | None]]
Kind = tuple[str, Fault, Named | None]  # see `SetUp`
Draw = Callable[[np.random.Generator], Kind]
SHORT = (
    ("repeat", "repeat", "repeat", "steps", "workcycle"),
    ("steps", "workcycle", "sweep"),
    ("repeat", "repeat", "workcycle", "sweep"),
    KINDS,
)
ROWS_S, COUNTS, NOISE = (0.002, 0.005, 0.01, 0.02, 0.05), (2**13, 2**16, 2**20), (1e-5, 2e-5, 6e-5)
TRACKER_M, CAMERA_PX, POSES = (1e-4, 5e-4), (0.05, 0.2), (12, 40)
UNLOGGED = ("u_", "q_ref", "seq", "sent", "offset", "segments")  # one of them, in a third of the set-ups
BEHIND, BY_CAMERA = ("backlash", "link_length_error", "gravity_sag", "trolley"), ("focal_length_error", "late")
BY_JOINT: tuple[tuple[str, str, float, float], ...] = (  # name, field of `Fault`, sizes
    ("valve_deadband", "deadband", 0.01, 0.04),
    ("valve_lag", "lag_s", 0.02, 0.08),
    ("flow_gain_error", "gain", 0.04, 0.2),
    ("valve_asymmetry", "asymmetry", 0.05, 0.2),
    ("valve_hysteresis", "hysteresis", 0.01, 0.04),
    ("controller_gain_error", "kp", 0.05, 0.2),
    ("backlash", "backlash", 0.002, 0.006),
)
OF_MACHINE: tuple[tuple[str, str, float, float, int | None], ...] = (
    ("transport_delay", "delay_s", 0.01, 0.05, None),
    ("link_length_error", "length_m", 0.005, 0.02, 2),
    ("gravity_sag", "sag_rad_nm", 1e-6, 5e-6, 2),
    ("focal_length_error", "focal", 0.005, 0.02, None),
)
FOREIGN: tuple[tuple[str, dict[str, Any]], ...] = (  # no effect of the catalogue
    ("trolley", {"trolley_m": 0.01}),
    ("spool", {"spool_rate": (1.0, np.inf)}),
    ("warming", {"warming": 0.1}),
    ("gear", {"gear": (0.1, 0.0)}),
)
LATE_S = (0.02, 0.06)


@dataclass(frozen=True)
class SetUp:
    """`kind`: of fault; `named`: what is to be named, None where nothing of the catalogue explains it. `without`: what
    was not logged, empty if all was. `logged`: how, for `foreign_plant.write`.
    """

    kind: str
    fault: Fault
    named: Named | None
    without: str
    logged: dict[str, Any] = field(default_factory=dict)

    def write(self, place: Path) -> Path:
        """The recording."""
        write(place, self.fault, **self.logged)
        if self.without in ("u_", "q_ref", "seq"):
            return rewritten(place, without=(self.without,))
        if self.without == "sent":
            (place / "sent.csv").unlink()
        text = (place / "run.toml").read_text(encoding="utf-8")
        if self.without == "offset":
            text = text.replace(f"plc_to_pc_offset_s = {OFFSET_S}\n", "")
        if self.without == "segments":
            text = text[: text.index("[[segment]]")]
        (place / "run.toml").write_text(text, encoding="utf-8")
        return place


def _kinds() -> list[Draw]:
    def by_joint(name: str, where: str, low: float, high: float) -> Draw:
        def draw(rng: np.random.Generator) -> Kind:
            joint, size = int(rng.integers(2)), float(rng.uniform(low, high))
            size *= float(rng.choice([-1.0, 1.0])) if name in ("flow_gain_error", "controller_gain_error") else 1.0
            both = (size, 0.0) if joint == 0 else (0.0, size)
            return name, Fault(**{where: both}), [(name, joint + 1)]

        return draw

    def of_machine(name: str, where: str, low: float, high: float, joint: int | None) -> Draw:
        return lambda rng: (name, Fault(**{where: float(rng.uniform(low, high))}), [(name, joint)])

    def foreign(name: str, values: dict[str, Any]) -> Draw:
        return lambda _rng: (name, Fault(**values), None)

    return [
        lambda _rng: ("none", Fault(), []),
        *(by_joint(*one) for one in BY_JOINT),
        *(of_machine(*one) for one in OF_MACHINE),
        lambda rng: ("late", Fault(camera_late_s=float(rng.uniform(*LATE_S))), [("camera_latency", None)]),
        *(foreign(*one) for one in FOREIGN),
    ]


def drawn(seed: int) -> SetUp:
    """The set-up of a seed; its kind goes round.

    Not drawn together: coarse encoders and a fine tracker, which in this plant sees what they show; a camera and a
    length, a sag or a play, which it does not see.
    """
    rng = np.random.default_rng([seed, 6])
    kinds = _kinds()
    kind, fault, named = kinds[seed % len(kinds)](rng)
    counts = int(rng.choice(COUNTS))
    logged: dict[str, Any] = {
        "seed": seed,
        "seconds": float(rng.choice([10.0, 20.0])),
        "noise": float(rng.choice(NOISE)),
        "kinds": SHORT[int(rng.integers(len(SHORT)))],
        "log_s": float(rng.choice(ROWS_S)),
        "counts": counts,
    }
    if kind in BEHIND or rng.random() < 0.3:
        logged["tracker_m"] = float(rng.choice(TRACKER_M)) if counts > min(COUNTS) else max(TRACKER_M)
    if rng.random() < (0.7 if kind in BEHIND and kind != "backlash" else 0.2):
        logged["static"] = int(rng.choice(POSES))
    if kind in BY_CAMERA or (kind not in BEHIND and rng.random() < 0.15):
        logged["camera_px"] = float(rng.choice(CAMERA_PX))
    without = str(rng.choice(UNLOGGED)) if rng.random() < 1.0 / 3.0 else ""
    if without == "offset" and kind in ("late", "transport_delay"):
        without = ""  # with it nobody can tell
    return SetUp(kind, fault, named, without, logged)
