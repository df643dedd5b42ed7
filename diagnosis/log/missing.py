"""Columns without which no row of a file can be used: named, in a folder and in an MCAP file alike."""

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.log.tables import MarkerTable, OdometryTable, PointTable, Tables
from machine.rotations import Array

POSITION_COLUMNS = ("x_m", "y_m", "z_m")
QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
CORNER_COLUMNS = tuple(f"{axis}{corner}_px" for corner in range(4) for axis in "uv")


def missing_columns(tables: Tables) -> list[Finding]:
    """Of points, markers and odometry, the columns in which no row has anything."""
    found = []
    for subject, table in (("static.csv", tables.static), ("tracker.csv", tables.tracker)):
        if table is not None:
            found += _missing_column_findings(
                subject, _of_points(table, subject == "static.csv"), "no point can be used"
            )
    if tables.markers is not None:
        found += _missing_column_findings("markers.csv", _of_markers(tables.markers), "no marker can be used whole")
    if tables.odometry is not None:
        found += _of_odometry(tables.odometry)
    return found


def _empty_columns(values: Array, names: tuple[str, ...]) -> list[str]:
    """The names of the columns (m, k) without a finite number."""
    return [name for k, name in enumerate(names) if not np.isfinite(values[:, k]).any()]


def _of_points(table: PointTable, at_rest: bool) -> list[str]:
    columns = [] if any(table.point_names) else ["point"]
    columns += _empty_columns(table.xyz, POSITION_COLUMNS)
    if at_rest and table.q is None:
        columns.append("q_<j>_rad")
    elif at_rest and table.q is not None:
        columns += _empty_columns(table.q, tuple(f"q_{j}_rad" for j in range(1, table.q.shape[1] + 1)))
    return columns


def _of_markers(table: MarkerTable) -> list[str]:
    columns = [] if (table.marker_ids >= 0).any() else ["marker_id"]
    return columns + _empty_columns(table.corners_px.reshape(len(table.corners_px), -1), CORNER_COLUMNS)


def _of_odometry(table: OdometryTable) -> list[Finding]:
    found = _missing_column_findings(
        "odometry.csv", _empty_columns(table.position_m, POSITION_COLUMNS), "no path of the camera is known"
    )
    turned = _missing_column_findings(
        "odometry.csv", _empty_columns(table.quat_wxyz, QUATERNION_COLUMNS), "how the camera turned is not known"
    )
    # A note only: lengths need no rotation.
    return found + [Finding(finding.code, "note", finding.subject, finding.text, finding.count) for finding in turned]


def _missing_column_findings(subject: str, columns: list[str], costs: str) -> list[Finding]:
    if not columns:
        return []
    text = f"{', '.join(columns)}: missing, or empty in every row; {costs}: add it"
    return [Finding("missing_column", "problem", subject, text, len(columns))]
