"""Step: the tool marker is seen, has its size, sits where the machine file says, and is seen again the same."""

import math
from collections.abc import Sequence

import numpy as np

from machine.description import Machine
from machine.poses import inverse_pose
from machine.rotations import Array, geodesic_angle
from server.camera.contracts import FrameReport
from server.commissioning.contracts import Figure, StepResult, Verdict, result_of_figures
from server.commissioning.looking import corners_by_stereo, disparities_px, fresh_pairs, mean_pose, mean_side_m
from server.commissioning.site import Site

TOOL_MARKER_STEP_NAME = "tool marker"
TOOL_MARKER_REMEDY = (
    "check the marker's id and printed size, T_tcp_tool and T_tcp_cam_left in the machine file, the camera's "
    "calibration, and that marker and camera sit firmly"
)
N_LOOKS = 6
PAIRS_PER_LOOK = 8
MARKER_SEEN_MIN_FRAC = 0.8
MARKER_SIDE_ERROR_MAX_PCT = 3.0  # printed size, baseline and focal length together
REPEATABILITY_MAX_MM = 0.5
REPEATABILITY_MAX_DEG = 0.5
MARKER_POSITION_ERROR_MAX_MM = 80.0  # a mounting measured by tape
MARKER_ROTATION_ERROR_MAX_DEG = 20.0


async def tool_marker(site: Site) -> StepResult:
    """Look several times without moving."""
    looks = [
        await fresh_pairs(site, PAIRS_PER_LOOK, f"look {number} of {N_LOOKS} at the tool marker")
        for number in range(1, N_LOOKS + 1)
    ]
    return judge_marker(looks, site.machine)


def judge_marker(looks: Sequence[Sequence[FrameReport]], machine: Machine) -> StepResult:
    """The result for several looks of some pairs each."""
    ids = tuple(marker.marker_id for marker in machine.markers_on("tool"))
    reports = [report for look in looks for report in look]
    seen = sum(any(view.marker_id in ids for view in report.observation.marker_views) for report in reports)
    found = sorted({view.marker_id for report in reports for view in report.observation.marker_views})
    first = Figure(
        f"marker {_marker_ids_text(ids)} seen",
        seen / max(len(reports), 1),
        "of the pairs",
        at_least=MARKER_SEEN_MIN_FRAC,
    )
    notes = [f"markers in view: {_marker_ids_text(found) or 'none'}"]
    poses = [pose for look in looks if (pose := mean_pose([report.observation.tool for report in look])) is not None]
    if not first.ok or len(poses) < 2:
        why = next((r.observation.tool.reason for r in reports if r.observation.tool.reason), "not in view")
        figures = (first, *disparity_figures(reports))
        return StepResult(
            TOOL_MARKER_STEP_NAME, Verdict.FAIL, f"{first.as_line}; {why}", figures, TOOL_MARKER_REMEDY, tuple(notes)
        )
    figures = [
        first,
        *disparity_figures(reports),
        *size_figures(reports, machine),
        *repeat_figures(poses),
        *place_figures(poses, machine),
    ]
    return result_of_figures(
        TOOL_MARKER_STEP_NAME,
        figures,
        f"marker {_marker_ids_text(ids)} seen at its expected place, repeatably",
        TOOL_MARKER_REMEDY,
        notes=notes,
    )


def _marker_ids_text(ids: Sequence[int]) -> str:
    return ", ".join(str(number) for number in ids)


def disparity_figures(reports: Sequence[FrameReport]) -> list[Figure]:
    """Left and right belong to their eyes: disparity is positive. None where no marker is in both eyes."""
    values = disparities_px(reports)
    return [Figure("disparity of the markers", float(np.median(values)), "px", at_least=1.0)] if values else []


def size_figures(reports: Sequence[FrameReport], machine: Machine) -> list[Figure]:
    """Side by stereo against the printed one; distance by stereo and by size."""
    sides = {marker.marker_id: marker.side_m for marker in machine.markers_on("tool")}
    ratios, depths = [], []
    for report in reports:
        for view in report.observation.marker_views:
            if view.marker_id in sides and view.corners_left_px is not None and view.corners_right_px is not None:
                corners = corners_by_stereo(machine.camera, view.corners_left_px, view.corners_right_px)
                ratios.append(mean_side_m(corners) / sides[view.marker_id])
                depths.append(float(np.linalg.norm(corners.mean(axis=0))))
    if not ratios:
        return [Figure("tool marker in both eyes", 0.0, "pairs", at_least=1.0)]
    ratio, depth_mm = float(np.median(ratios)), 1e3 * float(np.median(depths))
    return [
        Figure("distance by stereo", depth_mm, "mm"),
        Figure("distance by the printed size", depth_mm / ratio, "mm"),
        Figure("side by stereo off the printed one", 100.0 * abs(ratio - 1.0), "%", at_most=MARKER_SIDE_ERROR_MAX_PCT),
    ]


def repeat_figures(poses: Sequence[Array]) -> list[Figure]:
    """How much the looks differ from one another."""
    points = np.array([pose[:3, 3] for pose in poses])
    turns = [math.degrees(geodesic_angle(poses[0][:3, :3], pose[:3, :3])) for pose in poses[1:]]
    spread_mm = 1e3 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    return [
        Figure("looks differ in place by", spread_mm, "mm", at_most=REPEATABILITY_MAX_MM),
        Figure("looks differ in turn by", max(turns), "deg", at_most=REPEATABILITY_MAX_DEG),
    ]


def place_figures(poses: Sequence[Array], machine: Machine) -> list[Figure]:
    """Where the marker is seen against the mountings in the machine file."""
    T_nominal = inverse_pose(machine.T_tcp_cam_left) @ machine.T_tcp_tool
    T_seen = poses[len(poses) // 2]
    off_mm = 1e3 * float(np.linalg.norm(T_seen[:3, 3] - T_nominal[:3, 3]))
    turn_deg = math.degrees(geodesic_angle(T_nominal[:3, :3], T_seen[:3, :3]))
    return [
        Figure("marker off its nominal place", off_mm, "mm", at_most=MARKER_POSITION_ERROR_MAX_MM),
        Figure("marker off its nominal turn", turn_deg, "deg", at_most=MARKER_ROTATION_ERROR_MAX_DEG),
    ]
