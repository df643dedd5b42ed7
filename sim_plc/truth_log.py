"""The truth, for evaluating a run afterwards: true tool pose in the OOI by PLC time. The server never sees it."""

import csv
import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from machine.poses import inverse_pose, pose
from machine.rotations import Array, geodesic_angle, quat_wxyz_from_rotation
from sim_plc.world import World

TRUTH_LOG_PERIOD_NS = 20_000_000
FLUSH_ROWS = 25
_LISTED = 64  # longer arrays (actuator tables) are derived from shorter ones and only named
# fmt: off
TRUTH_CSV_COLUMNS = [
    "t_plc_s", "t_plc_ns", "x_ooi_tool_m", "y_ooi_tool_m", "z_ooi_tool_m", "qw_ooi_tool", "qx_ooi_tool", "qy_ooi_tool",
    "qz_ooi_tool", "error_x_mm", "error_y_mm", "error_z_mm", "error_rotation_deg", "x_base_tcp_m", "y_base_tcp_m",
    "z_base_tcp_m",
]
# fmt: on


class TruthLog:
    """truth.csv at 50 Hz and world.json with everything that was drawn.

    Errors are the tool minus the goal in OOI axes, for a goal `stand_off_m` in front of the OOI with the tool's axes
    along the OOI's, and the geodesic angle.
    """

    def __init__(self, folder: Path, world: World, stand_off_m: float = 0.1) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        drawn = {"stand_off_m": stand_off_m, **_to_json_value(world)}
        (folder / "world.json").write_text(json.dumps(drawn, indent=1), encoding="utf-8")
        self._file = (folder / "truth.csv").open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file)
        joints = range(1, len(world.nominal.joints) + 1)
        self._rows.writerow(
            [*TRUTH_CSV_COLUMNS, *(f"q_true_{j}_rad" for j in joints), *(f"q_encoder_{j}_rad" for j in joints)]
        )
        self._T_ooi_base = inverse_pose(world.scene.T_base_ooi)
        self._T_tcp_tool = world.scene.T_tcp_tool
        self._T_ooi_goal = pose(np.eye(3), np.array([0.0, 0.0, stand_off_m]))
        self._next_ns = 0
        self._count = 0

    def due(self, t_plc_ns: int) -> bool:
        """Whether a row should be written now."""
        return t_plc_ns >= self._next_ns

    def write(self, t_plc_ns: int, T_base_tcp: Array, q_true_rad: Array, q_encoder_rad: Array) -> None:
        """One row; q_true is behind the play, q_encoder what the PLC reads."""
        self._next_ns = t_plc_ns + TRUTH_LOG_PERIOD_NS
        T_ooi_tool = self._T_ooi_base @ T_base_tcp @ self._T_tcp_tool
        position, quat_wxyz = T_ooi_tool[:3, 3], quat_wxyz_from_rotation(T_ooi_tool[:3, :3])
        error_mm = (position - self._T_ooi_goal[:3, 3]) * 1e3
        angle_deg = np.rad2deg(geodesic_angle(self._T_ooi_goal[:3, :3], T_ooi_tool[:3, :3]))
        numbers = [*position, *quat_wxyz, *error_mm, angle_deg, *T_base_tcp[:3, 3], *q_true_rad, *q_encoder_rad]
        seconds, rest_ns = divmod(t_plc_ns, 1_000_000_000)
        self._rows.writerow([f"{seconds}.{rest_ns:09d}", t_plc_ns, *(f"{value:.9g}" for value in numbers)])
        self._count += 1
        if self._count % FLUSH_ROWS == 0:
            self._file.flush()

    def close(self) -> None:
        """Close truth.csv; later rows cannot be written."""
        self._file.close()


def _to_json_value(value: Any) -> Any:
    """Dataclasses and arrays as JSON."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: _to_json_value(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist() if value.size <= _LISTED else f"array {value.shape}"
    if isinstance(value, (list, tuple)):
        return [_to_json_value(item) for item in value]
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    return value
