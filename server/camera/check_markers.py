"""Are tool and OOI seen well enough to measure by them; if not, where to move, turn or light? Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from machine.camera import undistort_to_rays
from machine.description import Machine, StereoCamera
from machine.targets import Marker
from server.camera.check_findings import CheckFinding, Level, level_by_limits
from server.vision.contracts import Array, Image, MarkerView, PairObservation, PoseStatus
from server.vision.marker_search import cells_along_side, dictionary_by_name, marker_cells
from server.vision.object_pose import ObjectName
from server.vision.planar_pose import planar_poses

CELL_WARN_PX, CELL_FAIL_PX = 5.0, 3.0
CONTRAST_WARN_GREY, CONTRAST_FAIL_GREY = 50.0, 25.0
TILT_WARN_DEG, TILT_FAIL_DEG = 60.0, 75.0
SIGMA_WARN_MM, SIGMA_FAIL_MM = 1.0, 5.0
SEEN_WARN_FRAC, SEEN_FAIL_FRAC = 0.9, 0.5
BORDER_MARGIN_FRAC = 0.04  # of the picture's width that a marker should stay away from its border
FIX_RIG_FIRST_REMEDY = "fix the findings on eyes, rows and scale first"
RECTIFIED_CELL_PX = 8  # a cell of the straightened marker


@dataclass(frozen=True, slots=True)
class MarkerFigures:
    """One marker in one pair; its figures are the left eye's, or the right one's where only that sees it.

    `turn_right_deg`, `turn_down_deg`: by which the camera must turn so that both eyes hold it clear of their borders.
    `brighter_side`: side of the marker whose white is brighter ("left", ...), empty where all are alike.
    """

    marker_id: int
    seen_by_eyes: tuple[str, ...]
    cell_px: float
    contrast_grey: float
    tilt_deg: float
    distance_m: float
    turn_right_deg: float
    turn_down_deg: float
    brighter_side: str


@dataclass(slots=True)
class CheckedObjectCounts:
    """What all pairs showed of one object."""

    n_pairs: int = 0
    n_ok: int = 0
    n_both_eyes: int = 0  # pairs in which both eyes see one and the same marker
    statuses: dict[PoseStatus, int] = field(default_factory=dict)
    reasons: dict[str, int] = field(default_factory=dict)
    sigmas_mm: list[float] = field(default_factory=list)
    tilt_sigmas_deg: list[float] = field(default_factory=list)
    marker_figures: list[MarkerFigures] = field(default_factory=list)


def marker_figures(
    view: MarkerView, marker: Marker, machine: Machine, images: tuple[Image, Image]
) -> MarkerFigures | None:
    """What one marker looks like; None where no eye sees it whole."""
    corners = {
        name: np.asarray(found, dtype=float)
        for name, found in (("left", view.corners_left_px), ("right", view.corners_right_px))
        if found is not None
    }
    if not corners:
        return None
    name = "left" if "left" in corners else "right"
    image = images[0] if name == "left" else images[1]
    own, camera = corners[name], machine.camera
    cells = cells_along_side(dictionary_by_name(machine.dictionary))
    sides = np.linalg.norm(own - np.roll(own, -1, axis=0), axis=1)
    poses = planar_poses(undistort_to_rays(camera, own), marker.side_m)  # of one eye, whatever the other one does
    if not poses:
        return None
    tilt, distance = _tilt_and_distance(poses[0])
    contrast, brighter = _contrast_and_brighter_side(image, own, marker.marker_id, machine.dictionary)
    turn = _aiming_angles_deg(camera, corners, distance)
    return MarkerFigures(
        view.marker_id, tuple(corners), float(sides.min()) / cells, contrast, tilt, distance, *turn, brighter
    )


def _tilt_and_distance(T_eye_marker: Array) -> tuple[float, float]:
    """Angle between the marker's normal and the line of sight [deg], and distance [m]."""
    distance = float(np.linalg.norm(T_eye_marker[:3, 3]))
    towards = -T_eye_marker[:3, 3] / max(distance, 1e-9)
    return float(np.rad2deg(np.arccos(np.clip(T_eye_marker[:3, 2] @ towards, -1.0, 1.0)))), distance


def _contrast_and_brighter_side(
    image: Image, corners_px: Array, marker_id: int, dictionary_name: str
) -> tuple[float, str]:
    """White minus black of the printed cells [grey levels], and the side that is lit more."""
    white = marker_cells(dictionary_by_name(dictionary_name), marker_id)
    n = white.shape[0]
    size = n * RECTIFIED_CELL_PX
    square = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - np.float32(0.5)
    H = cv2.getPerspectiveTransform(corners_px.astype(np.float32), square)
    straight = cv2.warpPerspective(image, H, (size, size), flags=cv2.INTER_LINEAR)
    cells = straight.reshape(n, RECTIFIED_CELL_PX, n, RECTIFIED_CELL_PX)[:, 2:6, :, 2:6].mean(axis=(1, 3))
    contrast = float(cells[white].mean() - cells[~white].mean())
    rows, columns = np.nonzero(white)
    A = np.column_stack([columns - columns.mean(), rows - rows.mean(), np.ones(len(rows))])
    across, down, level = np.linalg.lstsq(A, cells[white], rcond=None)[0]
    gradient = n * np.array([across, down])  # over the marker, along its own axes as printed
    if np.abs(gradient).max() < 0.1 * max(level, 1.0):
        return contrast, ""
    x_axis, y_axis = corners_px[1] - corners_px[0], corners_px[3] - corners_px[0]
    in_picture = gradient[0] * x_axis / np.linalg.norm(x_axis) + gradient[1] * y_axis / np.linalg.norm(y_axis)
    if abs(in_picture[0]) >= abs(in_picture[1]):
        return contrast, "right" if in_picture[0] > 0 else "left"
    return contrast, "bottom" if in_picture[1] > 0 else "top"


def _aiming_angles_deg(camera: StereoCamera, corners: Mapping[str, Array], distance_m: float) -> tuple[float, float]:
    """Angles [deg] to the right and down by which the camera must turn to have the marker in both eyes."""
    disparity = camera.fx_px * camera.baseline_m / max(distance_m, 0.05)
    both = dict(corners)
    if "right" not in both:
        both["right"] = corners["left"] - [disparity, 0.0]
    if "left" not in both:
        both["left"] = corners["right"] + [disparity, 0.0]
    points = np.vstack(list(both.values()))
    margin = BORDER_MARGIN_FRAC * camera.width_px
    low, high = np.full(2, margin), np.array([camera.width_px, camera.height_px]) - 1.0 - margin
    off = np.maximum(points.max(axis=0) - high, 0.0) - np.maximum(low - points.min(axis=0), 0.0)
    angles = np.rad2deg(np.arctan(off / [camera.fx_px, camera.fy_px]))
    return float(angles[0]), float(angles[1])


def tally_markers(
    machine: Machine, pairs: Sequence[tuple[Image, Image]], seen: Sequence[PairObservation]
) -> dict[ObjectName, CheckedObjectCounts]:
    """Everything that the pairs show of tool and OOI."""
    found: dict[ObjectName, CheckedObjectCounts] = {"tool": CheckedObjectCounts(), "ooi": CheckedObjectCounts()}
    markers = {marker.marker_id: marker for marker in machine.markers}
    for images, observation in zip(pairs, seen, strict=True):
        for pose in (observation.tool, observation.ooi):
            counted = found[pose.object_name]
            counted.n_pairs += 1
            counted.n_ok += pose.status is PoseStatus.OK
            counted.statuses[pose.status] = counted.statuses.get(pose.status, 0) + 1
            if pose.reason:
                counted.reasons[pose.reason] = counted.reasons.get(pose.reason, 0) + 1
            if pose.covariance is not None:
                variances = [
                    np.linalg.eigvalsh(part)[-1] for part in (pose.covariance[:3, :3], pose.covariance[3:, 3:])
                ]
                counted.tilt_sigmas_deg.append(float(np.rad2deg(np.sqrt(variances[0]))))
                counted.sigmas_mm.append(1e3 * float(np.sqrt(variances[1])))
        for name, counted in found.items():
            whole = [view for view in observation.marker_views if _is_on(view, markers, name)]
            counted.n_both_eyes += any(
                view.corners_left_px is not None and view.corners_right_px is not None for view in whole
            )
        for view in observation.marker_views:
            marker = markers.get(view.marker_id)
            figures = None if marker is None else marker_figures(view, marker, machine, images)
            if marker is not None and figures is not None:
                found[marker.on].marker_figures.append(figures)
    return found


def _is_on(view: MarkerView, markers: Mapping[int, Marker], name: ObjectName) -> bool:
    return view.marker_id in markers and markers[view.marker_id].on == name


def check_markers(tallies: Mapping[ObjectName, CheckedObjectCounts], rig_is_sound: bool = True) -> list[CheckFinding]:
    """Findings `tool`, `ooi` (seen, how well known), and `tool_view`, `ooi_view` (size, contrast, tilt, place).

    Args:    rig_is_sound: where it is not, poor poses come from the rig, and no other place or light helps.
    """
    findings = []
    for name, counted in tallies.items():
        seen = _measurement_finding(name, counted)
        findings.append(seen if rig_is_sound or seen.level is Level.OK else replace(seen, remedy=FIX_RIG_FIRST_REMEDY))
        if counted.marker_figures:
            findings.append(_view_quality_finding(name, counted))
    return findings


def _measurement_finding(name: ObjectName, one: CheckedObjectCounts) -> CheckFinding:
    share = one.n_ok / max(one.n_pairs, 1)
    figures = {"ok_frac": share}
    reason = max(one.reasons, key=lambda text: one.reasons[text], default="")
    level = level_by_limits(-share, -SEEN_WARN_FRAC, -SEEN_FAIL_FRAC)
    if level is not Level.OK:
        text = f"measured in {100 * share:.0f} % of the pairs: {reason or 'no marker of it found'}"
        return CheckFinding(name, level, text, _remedy_unseen(name, one), figures)
    sigma_mm, tilt_deg = float(np.median(one.sigmas_mm)), float(np.median(one.tilt_sigmas_deg))
    figures |= {"sigma_mm": sigma_mm, "tilt_sigma_deg": tilt_deg}
    level = level_by_limits(sigma_mm, SIGMA_WARN_MM, SIGMA_FAIL_MM)
    text = f"measured in {100 * share:.0f} % of the pairs, each to {sigma_mm:.2f} mm and {tilt_deg:.2f} deg"
    remedy = "" if level is Level.OK else _move_closer_advice(one, float(np.sqrt(SIGMA_WARN_MM / sigma_mm)))
    return CheckFinding(name, level, text, remedy, figures)


def _remedy_unseen(name: ObjectName, one: CheckedObjectCounts) -> str:
    """What to do about an object that is rarely measured: the reason's own remedy, unless the views show more."""
    aim = _aiming_advice(one)
    if aim:
        return aim
    if any("covered" in reason for reason in one.reasons):
        return f"clear the view to the {name}'s markers, wipe them, take shadows off them"
    if one.statuses.get(PoseStatus.ORIENTATION_AMBIGUOUS):
        return "come closer, or turn the camera so that it sees the markers 15 to 30 deg from the side"
    if one.statuses.get(PoseStatus.REJECTED):
        return "check marker sides and layout in the machine file, and that no marker has moved on its board"
    return f"turn or move the camera until the {name}'s markers are in both pictures; light them; check their ids"


def _view_quality_finding(name: ObjectName, one: CheckedObjectCounts) -> CheckFinding:
    """The worst of size, contrast, tilt and place over the object's markers."""
    cell = float(np.median([marker.cell_px for marker in one.marker_figures]))
    contrast = float(np.median([marker.contrast_grey for marker in one.marker_figures]))
    tilt = float(np.median([marker.tilt_deg for marker in one.marker_figures]))
    distance = float(np.median([marker.distance_m for marker in one.marker_figures]))
    both = one.n_both_eyes / max(one.n_pairs, 1)
    ids = sorted({marker.marker_id for marker in one.marker_figures})
    text = (
        f"markers {', '.join(map(str, ids))}: {cell:.1f} px a cell, contrast {contrast:.0f} of 255, tilt {tilt:.0f} "
        f"deg, {distance:.2f} m away, by both eyes in {100 * both:.0f} % of the pairs"
    )
    figures = {
        "cell_px": cell,
        "contrast_grey": contrast,
        "tilt_deg": tilt,
        "distance_m": distance,
        "both_eyes_frac": both,
    }
    judged = (
        (level_by_limits(-cell, -CELL_WARN_PX, -CELL_FAIL_PX), lambda: _move_closer_advice(one, cell / CELL_WARN_PX)),
        (level_by_limits(-contrast, -CONTRAST_WARN_GREY, -CONTRAST_FAIL_GREY), lambda: _lighting_advice(one, contrast)),
        (
            level_by_limits(tilt, TILT_WARN_DEG, TILT_FAIL_DEG),
            lambda: f"go {tilt - 45.0:.0f} deg round the {name}, to its front",
        ),
        (level_by_limits(-both, -SEEN_WARN_FRAC, 0.0), lambda: _aiming_advice(one) or "clear the view of both eyes"),
    )
    worst = max((level for level, _ in judged), key=(Level.OK, Level.WARN, Level.FAIL).index)
    remedies = [remedy() for level, remedy in judged if level is not Level.OK]
    return CheckFinding(f"{name}_view", worst, text, "; ".join(remedies), figures)


def _move_closer_advice(one: CheckedObjectCounts, share: float) -> str:
    """Of the present distance only this share may remain."""
    distance = float(np.median([marker.distance_m for marker in one.marker_figures])) if one.marker_figures else 0.0
    away = distance * (1.0 - share)
    return f"move {max(away, 0.1):.1f} m closer" if distance else "move closer"


def _lighting_advice(one: CheckedObjectCounts, contrast: float) -> str:
    """Light from the side that is darker now."""
    opposite = {"left": "the right", "right": "the left", "top": "below", "bottom": "above"}
    sides = [marker.brighter_side for marker in one.marker_figures if marker.brighter_side]
    side = (
        opposite[max(set(sides), key=sides.count)]
        if len(sides) > 0.5 * len(one.marker_figures)
        else "the camera's side"
    )
    return f"light from {side}: contrast {contrast:.0f} of 255"


def _aiming_advice(one: CheckedObjectCounts) -> str:
    """How to turn the camera, where markers stand at a border or beyond it; empty where they do not."""
    single = [marker for marker in one.marker_figures if len(marker.seen_by_eyes) == 1] or one.marker_figures
    if not single:
        return ""
    right = float(np.median([marker.turn_right_deg for marker in single]))
    down = float(np.median([marker.turn_down_deg for marker in single]))
    parts = []
    for value, positive, negative in ((right, "to the right", "to the left"), (down, "down", "up")):
        if abs(value) >= 0.5:
            parts.append(f"{max(1.0, abs(value)):.0f} deg {positive if value > 0 else negative}")
    return f"turn the camera {' and '.join(parts)}" if parts else ""
