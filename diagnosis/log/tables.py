"""A recording's rows as arrays, still as they were written: nothing is resampled, sorted or repaired here.

Numbers beyond 1e9, which no angle, length or pressure reaches, count as infinite.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from machine.rotations import Array
from recording.content import Recording
from recording.rows import MarkerCorners, OdometryRow, PlcState, Row, Sent, StaticPoint, TrackerPoint
from recording.run import RunInfo

#: Columns of the PLC's rows with one number a joint: name here, field of the row, column in plc.csv.
JOINT_SIGNAL_COLUMNS = (
    ("ref", "q_ref_rad", "q_ref_{j}_rad"),
    ("enc", "q_rad", "q_{j}_rad"),
    ("u", "u_frac", "u_{j}_frac"),
    ("p_a", "p_a_pa", "p_a_{j}_pa"),
    ("p_b", "p_b_pa", "p_b_{j}_pa"),
)


FINITE_VALUE_MAX = 1e9
COUNT_MAX = 2**62


@dataclass(frozen=True, slots=True)
class PlcTable:
    """The PLC's log: t_s (m,); signals (m, n) or None where never written; missing numbers are NaN.

    `ref_logged`: False where `ref` is what was sent in the datagram that each row names.
    """

    t_s: Array
    ref: Array | None
    enc: Array | None
    u: Array | None
    p_a: Array | None
    p_b: Array | None
    p_supply: Array | None
    seq: NDArray[np.int64]
    ref_logged: bool = True


@dataclass(frozen=True, slots=True)
class SentTable:
    """The reference as sent: t_s (m,) on the PC's clock, seq (m,), q (m, n)."""

    t_s: Array
    seq: NDArray[np.int64]
    q: Array


@dataclass(frozen=True, slots=True)
class MarkerTable:
    """Marker corners: t_s (m,) on the camera's clock, eye (m,) 0 left 1 right, marker_ids (m,), corners_px
    (m, 4, 2).
    """

    t_s: Array
    eye: NDArray[np.int64]
    marker_ids: NDArray[np.int64]
    corners_px: Array


@dataclass(frozen=True, slots=True)
class OdometryTable:
    """Odometry: t_s (m,) on the camera's clock, position_m (m, 3), quat_wxyz (m, 4)."""

    t_s: Array
    position_m: Array
    quat_wxyz: Array


@dataclass(frozen=True, slots=True)
class PointTable:
    """Measured points: t_s (m,) on the PLC's clock (static: pose index), point_names (m,), xyz (m, 3),
    q (m, n) or None.
    """

    t_s: Array
    point_names: tuple[str, ...]
    xyz: Array
    q: Array | None

    def without_rows(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """The table with rows left out, by a mask (m,) or their numbers: they hold no place."""
        xyz = self.xyz.copy()
        xyz[rows] = np.nan
        return replace(self, xyz=xyz)


@dataclass(frozen=True, slots=True)
class Tables:
    """All tables of a recording; None where it has no such rows. `joint_count`: 0 where no table says."""

    run_info: RunInfo
    joint_count: int
    plc: PlcTable | None
    sent: SentTable | None
    markers: MarkerTable | None
    odometry: OdometryTable | None
    tracker: PointTable | None
    static: PointTable | None


def tables_of(recording: Recording) -> Tables:
    """The tables of a recording."""
    plc, static, sent = recording.of(PlcState), recording.of(StaticPoint), recording.of(Sent)
    widths = [len(getattr(row, field)) for row in plc for _, field, _ in JOINT_SIGNAL_COLUMNS]
    n = max([*widths, *(len(row.q_rad) for row in static), *(len(row.q_sent_rad) for row in sent)], default=0)
    return Tables(
        run_info=recording.run_info,
        joint_count=n,
        plc=_plc_table(plc, n) if plc else None,
        sent=SentTable(
            _float_column(sent, "t_pc_s"), _integer_column(sent, "seq"), _float_matrix(sent, "q_sent_rad", n)
        )
        if sent
        else None,
        markers=_marker_table(recording.of(MarkerCorners)),
        odometry=_odometry_table(recording.of(OdometryRow)),
        tracker=_point_table(recording.of(TrackerPoint), "t_plc_s", 0),
        static=_point_table(static, "pose_index", n),
    )


def fill_gaps(values: Array) -> Array:
    """(m, n) with missing and infinite numbers on straight lines between their neighbours; empty columns are 0."""
    out = np.array(values, dtype=float)
    rows = np.arange(len(out))
    for j in range(out.shape[1]):
        good = np.isfinite(out[:, j])
        if not good.all():
            out[:, j] = np.interp(rows, rows[good], out[good, j]) if good.any() else 0.0
    return out


def largest_finite(values: Array) -> float:
    """Largest finite absolute value; 0 without any."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _float_column(rows: Sequence[Row], name: str) -> Array:
    return np.array([getattr(row, name) for row in rows], dtype=float)


def _integer_column(rows: Sequence[Row], name: str) -> NDArray[np.int64]:
    return np.array([min(max(getattr(row, name), -1), COUNT_MAX) for row in rows], dtype=np.int64)


def _float_matrix(rows: Sequence[Row], name: str, n: int) -> Array:
    """(m, n), NaN where a row has no or fewer numbers."""
    values = np.full((len(rows), n), np.nan)
    for k, row in enumerate(rows):
        numbers = getattr(row, name)
        values[k, : len(numbers)] = numbers
    return _huge_to_infinity(values)


def _huge_to_infinity(values: Array) -> Array:
    return np.where(np.abs(values) > FINITE_VALUE_MAX, np.inf, values)


def _plc_table(rows: Sequence[PlcState], n: int) -> PlcTable:
    found = {short: _float_matrix(rows, field, n) for short, field, _ in JOINT_SIGNAL_COLUMNS}
    kept = {short: values if np.isfinite(values).any() else None for short, values in found.items()}
    supply = _float_column(rows, "p_supply_pa")
    return PlcTable(
        t_s=_float_column(rows, "t_plc_s"),
        p_supply=supply if np.isfinite(supply).any() else None,
        seq=_integer_column(rows, "seq_received"),
        ref_logged=True,
        **kept,
    )


def _marker_table(rows: Sequence[MarkerCorners]) -> MarkerTable | None:
    if not rows:
        return None
    corners = [[(getattr(row, f"u{c}_px"), getattr(row, f"v{c}_px")) for c in range(4)] for row in rows]
    eye = np.array([{"left": 0, "right": 1}.get(row.eye, -1) for row in rows], dtype=np.int64)
    return MarkerTable(
        _float_column(rows, "t_camera_s"),
        eye,
        _integer_column(rows, "marker_id"),
        _huge_to_infinity(np.array(corners, dtype=float)),
    )


def _odometry_table(rows: Sequence[OdometryRow]) -> OdometryTable | None:
    if not rows:
        return None
    position = np.stack([_float_column(rows, name) for name in ("x_m", "y_m", "z_m")], axis=1)
    quat = np.stack([_float_column(rows, name) for name in ("qw", "qx", "qy", "qz")], axis=1)
    return OdometryTable(_float_column(rows, "t_camera_s"), position, quat)


def _point_table(rows: Sequence[TrackerPoint] | Sequence[StaticPoint], key: str, n: int) -> PointTable | None:
    if not rows:
        return None
    xyz = _huge_to_infinity(np.stack([_float_column(rows, name) for name in ("x_m", "y_m", "z_m")], axis=1))
    q = _float_matrix(rows, "q_rad", n) if n else None
    return PointTable(_float_column(rows, key), tuple(row.point for row in rows), xyz, q)
