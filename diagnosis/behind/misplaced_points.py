"""Points under each other's names, in a frame that is not the one given, or in a mirror: far from any fault."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from diagnosis.behind.points import PointData, fit_points, rms_m, static_data, tracked_data
from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import Tables
from diagnosis.replay.stretches import Stretch
from machine.effects.entries import pack_under
from machine.poses import inverse_pose
from machine.rotations import geodesic_angle

MISPLACEMENT_MIN_M = 0.02  # points nearer to where they belong are where they belong, faults aside
IMPROVEMENT_RATIO_MIN = 5.0  # how much nearer they have to lie by the correction stated
TURNED_RAD, MOVED_M = 0.35, 0.2  # of a frame: no base tilts so far nor settles, no encoder's zero is so far off
AXIS_REFLECTIONS = (
    ("x", np.diag([-1.0, 1.0, 1.0])),
    ("y", np.diag([1.0, -1.0, 1.0])),
    ("z", np.diag([1.0, 1.0, -1.0])),
)


def misplaced_points(tables: Tables, nominal: Nominal, stretches: tuple[Stretch, ...]) -> list[Finding]:
    """Measured points that are far from the arm as they are written, and on it when taken another way.

    Ways:  two points under each other's names; another frame than the one given; one axis with the other sign.
    """
    if nominal.arm is None:
        return []
    both = (
        ("static.csv", None if tables.static is None else static_data(nominal, tables.static)),
        ("tracker.csv", None if tables.tracker is None else tracked_data(nominal, tables.tracker, stretches)),
    )
    return [
        finding
        for subject, data in both
        if data is not None and len(data.xyz) > len(np.unique(data.point_index)) + 3
        for finding in _of_file(subject, nominal, data)
    ]


def _of_file(subject: str, nominal: Nominal, data: PointData) -> list[Finding]:
    as_written = _away_m(nominal, data)
    if as_written < MISPLACEMENT_MIN_M:
        return []
    written, wanted = f"as written they lie {1e3 * as_written:.3g} mm from the arm", as_written / IMPROVEMENT_RATIO_MIN
    named = [k for k in np.unique(data.point_index).tolist() if nominal.tracked_points[k].xyz_m is not None]
    ways = [(_away_m(nominal, _swap_point_names(data, pair)), pair) for pair in combinations(named, 2)]
    if ways and min(ways)[0] < wanted:
        away, pair = min(ways)
        a, b = (nominal.tracked_points[k].name for k in pair)
        text = f"points {a!r} and {b!r} are exchanged: {written}, under each other's name {1e3 * away:.3g} mm"
        return [Finding("exchanged_points", "fatal", subject, text, 2)]
    anywhere = replace(nominal, T_base_tracker=None)
    fit = fit_points(anywhere, pack_under(nominal.baseline_effects, nominal.n), data)
    if nominal.T_base_tracker is not None and rms_m(fit.residual_m) < wanted:
        off = fit.T_base_tracker @ inverse_pose(nominal.T_base_tracker)
        turned, moved = geodesic_angle(off[:3, :3], np.eye(3)), float(np.linalg.norm(off[:3, 3]))
        if turned > TURNED_RAD or moved > MOVED_M:
            text = f"the points are not in the frame that T_base_tracker gives: {written}, in one that is turned by "
            text += f"{np.rad2deg(turned):.3g} deg and moved by {moved:.3g} m {1e3 * rms_m(fit.residual_m):.3g} mm; "
            return [Finding("machine_mismatch", "fatal", subject, f"{text}correct it, or leave it out")]
    for frame, axes in ((nominal, AXIS_REFLECTIONS), (anywhere, AXIS_REFLECTIONS[:1])):
        away, axis = min((_away_m(frame, replace(data, xyz=data.xyz @ mirror)), axis) for axis, mirror in axes)
        if away < wanted:
            which = f"the other sign of {axis}" if frame is nominal else "the other sign of one axis"
            text = f"the points are mirrored: {written}, with {which} {1e3 * away:.3g} mm"
            return [Finding("machine_mismatch", "fatal", subject, f"{text}; write a right-handed frame")]
    return []


def _swap_point_names(data: PointData, pair: tuple[int, int]) -> PointData:
    a, b = pair
    return replace(
        data, point_index=np.where(data.point_index == a, b, np.where(data.point_index == b, a, data.point_index))
    )


def _away_m(nominal: Nominal, data: PointData) -> float:
    """Root mean square distance of the points from the nominal arm."""
    return rms_m(fit_points(nominal, pack_under(nominal.baseline_effects, nominal.n), data).residual_m)
