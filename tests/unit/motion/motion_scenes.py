"""Scenes for the motion tests: the nominal machine in usual postures in front of a wall."""

from functools import cache
from pathlib import Path

import numpy as np

from machine.chain import Chain, chain_of
from machine.description import Machine, parse_machine_toml
from machine.kinematics import tcp_pose
from machine.poses import pose
from server.motion.contracts import Wall

_MACHINES = Path(__file__).parents[3] / "machine" / "machines"
Q_USUAL = np.deg2rad([20.0, 30.0, -90.0, 0.0, -60.0, 0.0])


@cache
def machine() -> Machine:
    return parse_machine_toml((_MACHINES / "hiab033.toml").read_text(encoding="utf-8"))


@cache
def chain() -> Chain:
    return chain_of(machine())


def posture(seed: int) -> np.ndarray:
    """A posture with the tool horizontal, the wrist well bent and room to move ahead, of the kind the presets draw."""
    rng = np.random.default_rng(seed)
    while True:
        slew, lift, tilt = rng.uniform([-40, 5, -125], [40, 50, -75])
        if -85.0 < lift + tilt < -35.0:
            return np.deg2rad([slew, lift, tilt, 0.0, lift + tilt, 0.0])


def shifted(q: np.ndarray, offset_tcp: list[float]) -> np.ndarray:
    """Pose of the TCP at q, shifted along its own axes [m]."""
    T = tcp_pose(chain(), q)
    return pose(T[:3, :3], T[:3, 3] + T[:3, :3] @ np.array(offset_tcp))


def ooi_ahead(q: np.ndarray, distance_m: float, up_m: float = 0.0, left_m: float = 0.0) -> np.ndarray:
    """T_base_ooi with axes parallel to the tool's, ahead of the TCP."""
    T = shifted(q, [up_m, left_m, -distance_m])
    return T @ pose(machine().T_tcp_tool[:3, :3], np.zeros(3))


def wall_of(T_base_ooi: np.ndarray, clearance_m: float = 0.05) -> Wall:
    """The wall's mean plane, 60 mm behind the OOI."""
    return Wall(T_base_ooi[:3, 3] - 0.06 * T_base_ooi[:3, 2], T_base_ooi[:3, 2], clearance_m)
