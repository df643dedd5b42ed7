"""How much of what was recorded can be used by a stage, and why the rest cannot."""

from typing import Literal

import numpy as np

from diagnosis.behind.points import POINT_ROWS_MIN as POINTS_MIN
from diagnosis.behind.points import tracked_angles, usable_rows
from diagnosis.behind.seen_corners import CLOCK_OFFSET_MARGIN_S, CORNER_ROWS_MIN, seen_rows
from diagnosis.datagrams.clocks import camera_to_plc_s
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import Tables
from diagnosis.replay.stretches import Stretch

PointFile = Literal["static", "tracker"]
ROW_REQUIREMENTS_BY_FILE = {
    "static": "a point of [points], its x_m, y_m, z_m, and every joint's q_<j>_rad",
    "tracker": "a point of [points], its x_m, y_m, z_m, and encoders logged at its time",
    "markers": "a marker of [markers], its eye, a corner, and of the ooi encoders logged at its time",
}


def points_usable(nominal: Nominal, tables: Tables, stretches: tuple[Stretch, ...], file: PointFile) -> int:
    """Rows of measured points that the arm can be judged by."""
    table = tables.static if file == "static" else tables.tracker
    if table is None:
        return 0
    q = table.q if file == "static" else tracked_angles(nominal, table, stretches)
    return 0 if q is None else int(usable_rows(nominal, table, q).sum())


def corners_usable(nominal: Nominal, tables: Tables, stretches: tuple[Stretch, ...]) -> int:
    """Rows of markers.csv that the camera can be judged by: the more of tool and ooi."""
    markers = tables.markers
    if markers is None:
        return 0
    tool = int(seen_rows(nominal, markers, "tool").sum()) if nominal.T_tcp_tool is not None else 0
    t_s = markers.t_s + camera_to_plc_s(tables)
    inside = np.zeros(len(t_s), dtype=bool)
    for stretch in stretches:
        if stretch.enc is not None:
            inside |= (t_s >= stretch.t_s[0] + CLOCK_OFFSET_MARGIN_S) & (t_s <= stretch.t_s[-1] - CLOCK_OFFSET_MARGIN_S)
    return max(tool, int((seen_rows(nominal, markers, "ooi") & inside).sum()))


def odometry_usable(tables: Tables, stretches: tuple[Stretch, ...]) -> bool:
    """Whether the camera's path is known anywhere while encoders were logged somewhere."""
    table = tables.odometry
    if table is None or not any(stretch.enc is not None for stretch in stretches):
        return False
    return bool((np.isfinite(table.t_s) & np.isfinite(table.position_m).all(axis=1)).any())


def enough_points(nominal: Nominal, tables: Tables, stretches: tuple[Stretch, ...]) -> bool:
    """Whether a file of points has the rows that a cell of them needs."""
    return any(points_usable(nominal, tables, stretches, file) >= POINTS_MIN for file in ("static", "tracker"))


def enough_corners(nominal: Nominal, tables: Tables, stretches: tuple[Stretch, ...]) -> bool:
    """Whether there are the rows that a cell of corners needs."""
    return corners_usable(nominal, tables, stretches) >= CORNER_ROWS_MIN


def why_unused(nominal: Nominal | None, tables: Tables, stretches: tuple[Stretch, ...]) -> list[str]:
    """What was recorded and is not used by any stage: how many rows, and what a row would need."""
    found = _segments_outside_log(tables, stretches)
    if nominal is None or nominal.arm is None:
        return found
    static, tracker, markers = tables.static, tables.tracker, tables.markers
    if static is not None:
        count = points_usable(nominal, tables, stretches, "static")
        found += _too_few("static", count, len(static.t_s), POINTS_MIN)
    if tracker is not None:
        count = points_usable(nominal, tables, stretches, "tracker")
        found += _too_few("tracker", count, len(tracker.t_s), POINTS_MIN)
    if markers is not None:
        found += _too_few("markers", corners_usable(nominal, tables, stretches), len(markers.t_s), CORNER_ROWS_MIN)
    return found


def _too_few(file: str, count: int, total: int, least: int) -> list[str]:
    if count >= least:
        return []
    return [
        f"{file}.csv: {count} of {total} rows can be used, least {least}; a row needs {ROW_REQUIREMENTS_BY_FILE[file]}"
    ]


def _segments_outside_log(tables: Tables, stretches: tuple[Stretch, ...]) -> list[str]:
    """Segments that lie outside the whole log: two clocks."""
    plc, segments = tables.plc, tables.run_info.segments
    if plc is None or stretches or not segments or not np.isfinite(plc.t_s).any():
        return []
    first, last = float(np.nanmin(plc.t_s)), float(np.nanmax(plc.t_s))
    starts, ends = min(segment.t_start_plc_s for segment in segments), max(segment.t_end_plc_s for segment in segments)
    if any(segment.t_start_plc_s <= last and segment.t_end_plc_s >= first for segment in segments):
        return []
    log, named = f"the log at {first:.10g} .. {last:.10g} s", f"segments lie at {starts:.10g} .. {ends:.10g} s"
    return [f"{named}, {log}: give both on the PLC's clock, or leave the segments out"]
