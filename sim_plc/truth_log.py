"""The truth, for whoever judges a run afterwards: true tool pose in the OOI by PLC time. The server never sees it."""

import csv
import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import Array, geodesic_angle, quat_wxyz_from_rotation
from sim_plc.world import World

PERIOD_NS = 20_000_000
FLUSH_ROWS = 25
COLUMNS = [
    "t_plc_s",
    "t_plc_ns",
    "x_ooi_tool_m",
    "y_ooi_tool_m",
    "z_ooi_tool_m",
    "qw",
    "qx",
    "qy",
    "qz",
    "error_x_mm",
    "error_y_mm",
    "error_z_mm",
    "error_rotation_deg",
    "x_base_tcp_m",
    "y_base_tcp_m",
    "z_base_tcp_m",
]


class TruthLog:
    """truth.csv at 50 Hz and world.json with everything that was drawn. `stand_off_m` is the goal's distance."""

    def __init__(self, folder: Path, world: World, stand_off_m: float = 0.1) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "world.json").write_text(json.dumps(_plain(world), indent=1), encoding="utf-8")
        self._file = (folder / "truth.csv").open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file)
        joints = len(world.nominal.joints)
        self._rows.writerow([*COLUMNS, *(f"q_{j + 1}_rad" for j in range(joints))])
        self._scene = world.scene
        self._T_ooi_goal = pose(np.eye(3), np.array([0.0, 0.0, stand_off_m]))
        self._next_ns = 0
        self._count = 0

    def due(self, t_plc_ns: int) -> bool:
        """Whether a row should be written now."""
        return t_plc_ns >= self._next_ns

    def write(self, t_plc_ns: int, T_base_tcp: Array, q_rad: Array) -> None:
        """One row."""
        self._next_ns = t_plc_ns + PERIOD_NS
        T_ooi_tool = inverse_pose(self._scene.T_base_ooi) @ T_base_tcp @ self._scene.T_tcp_tool
        position, quat = T_ooi_tool[:3, 3], quat_wxyz_from_rotation(T_ooi_tool[:3, :3])
        error_mm = (position - self._T_ooi_goal[:3, 3]) * 1e3
        angle_deg = np.rad2deg(geodesic_angle(self._T_ooi_goal[:3, :3], T_ooi_tool[:3, :3]))
        numbers = [*position, *quat, *error_mm, angle_deg, *T_base_tcp[:3, 3], *q_rad]
        self._rows.writerow([f"{t_plc_ns * 1e-9:.9f}", t_plc_ns, *(f"{value:.9g}" for value in numbers)])
        self._count += 1
        if self._count % FLUSH_ROWS == 0:
            self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _plain(value: Any) -> Any:
    """Dataclasses and arrays as JSON; the texture-free world is small."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist() if value.size <= 64 else f"array {value.shape}"
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    return value
