"""Boreholes and rings against the truth: found, false, error of centre and axis, and whether ellipses hold."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from benchmarks.targets.patches import CHI2_3_95
from benchmarks.targets.scene import bare_rock_setup, left_eye, view
from machine.camera import project, project_stereo
from machine.description import Machine
from machine.poses import inverse_pose, transform_points
from machine.rotations import Array
from server.targets.contracts import TargetSettings
from server.targets.round_marks import RoundMark, find_round_marks
from server.targets.surface import CHI2_2_95
from sim_plc.camera.renderer import StereoRenderer
from sim_plc.camera.round_marks import MARKS_MAX, draw_marks
from sim_plc.camera.wall import wall_relief
from sim_plc.world import RoundMark as TrueMark

DIAMETERS_M = (0.045, 0.051, 0.064, 0.076, 0.08, 0.1)  # all that a wall may have, given to the search
DISTANCES_M = ((0.03, 0.15), (0.4, 0.6))  # of the tool; the camera stands about half a metre behind it
TILT_DEG = 20.0
MARGIN_PX = 14.0  # of a visible rim from the picture's border
SAME_PX = 8.0  # a found centre this near to a true one is that mark
SAME_SIZE_FRAC = 0.06


@dataclass(frozen=True, slots=True)
class HoleCase:
    """One mark of one picture. kind: hole, ring, or false (found and not there). Errors NaN where it was not measured;
    chi2 of the centre (3 dof) and of the axis (2 dof)."""

    seed: int
    kind: str
    diameter_mm: float
    range_m: float
    oblique_deg: float
    visible: bool
    found: bool
    status: str
    centre_mm: float
    axis_deg: float
    diameter_error_mm: float
    chi2_centre: float
    chi2_axis: float

    @property
    def near(self) -> bool:
        """Whether the camera stood at about 0.6 m."""
        return self.range_m < 0.8

    @property
    def holds_centre(self) -> bool:
        """Whether the centre's 95 % ellipsoid holds the truth."""
        return self.chi2_centre <= CHI2_3_95

    @property
    def holds_axis(self) -> bool:
        """Whether the axis' 95 % ellipse holds the truth."""
        return self.chi2_axis <= CHI2_2_95


def marked_rock(
    machine: Machine, seed: int, contrast_frac: float, count: int
) -> tuple[StereoRenderer, tuple[TrueMark, ...]]:
    """A renderer of a wall without markers with so many round marks, and their truth; base = OOI frame."""
    setup = bare_rock_setup(machine, seed, contrast_frac)
    scene = setup.scene
    relief = wall_relief(scene.texture_seed, scene.wall_relief_m, scene.wall_offset_m)
    marks = draw_marks(seed, count, relief)
    return StereoRenderer(replace(setup, scene=replace(scene, round_marks=marks))), marks


def hole_cases(machine: Machine, seed: int, settings: TargetSettings) -> list[HoleCase]:
    """The marks of one wall in two pictures: the camera at about 0.6 m and at about 1 m, up to 20 deg oblique."""
    rng = np.random.default_rng([seed, 0x686F6C65])
    count = int(rng.integers(1, MARKS_MAX + 1))
    renderer, marks = marked_rock(machine, seed, float(rng.uniform(0.5, 1.0)), count)
    cases = []
    for low, high in DISTANCES_M:
        T = view(machine, rng, float(rng.uniform(low, high)), TILT_DEG)
        cases += _picture(machine, renderer, seed, marks, T, rng, settings)
    return cases


def _picture(
    machine: Machine,
    renderer: StereoRenderer,
    seed: int,
    marks: tuple[TrueMark, ...],
    T_base_tcp: Array,
    rng: np.random.Generator,
    settings: TargetSettings,
) -> list[HoleCase]:
    left, right = renderer.render_static(T_base_tcp, rng)
    tool = own_tool_px(renderer)
    found = find_round_marks(left, right, machine.camera, DIAMETERS_M, settings, tool).marks
    T_cam_ooi = inverse_pose(left_eye(renderer, T_base_tcp))
    cases, matched = [], set()
    for mark in marks:
        T_cam_mark = T_cam_ooi @ mark.T_ooi_mark
        hit = next((one for one in found if _is_same(machine, one, mark, T_cam_mark)), None)
        if hit is not None:
            matched.add(hit.number)
        cases.append(_case(machine, seed, mark, T_cam_mark, hit, tool))
    empty = [one for one in found if one.number not in matched]
    range_m = float(np.median([case.range_m for case in cases]))
    nan = float("nan")
    for one in empty:
        size = 1e3 * one.diameter_m
        cases.append(HoleCase(seed, "false", size, range_m, nan, False, True, one.patch.status.value, *[nan] * 5))
    return cases


def own_tool_px(renderer: StereoRenderer) -> tuple[list[Array], list[Array]]:
    """Polygons (4, 2) [px] of the tool's boards in both eyes."""
    polygons = []
    for eye in renderer.eyes:
        T_cam_tcp = inverse_pose(eye.T_tcp_cam)
        outlines = [transform_points(T_cam_tcp @ one.T_object_board, one.outline) for one in renderer.tool_boards]
        polygons.append([project(eye.rays.camera, one) for one in outlines if (one[:, 2] > 0.05).all()])
    return polygons[0], polygons[1]


def _is_same(machine: Machine, found: RoundMark, mark: TrueMark, T_cam_mark: Array) -> bool:
    pixel = project(machine.camera, T_cam_mark[None, :3, 3])[0]
    near = float(np.hypot(*(np.array(found.patch.pixel) - pixel))) < SAME_PX
    return near and abs(found.diameter_m - mark.diameter_m) < SAME_SIZE_FRAC * mark.diameter_m


def _case(
    machine: Machine, seed: int, mark: TrueMark, T: Array, hit: RoundMark | None, tool: tuple[list[Array], list[Array]]
) -> HoleCase:
    range_m = float(np.linalg.norm(T[:3, 3]))
    oblique = float(np.rad2deg(np.arccos(np.clip(-T[:3, 2] @ T[:3, 3] / range_m, -1.0, 1.0))))
    visible = is_visible(machine, T, 0.5 * mark.diameter_m, tool)
    known = (seed, mark.kind, 1e3 * mark.diameter_m, range_m, oblique, visible)
    nan = float("nan")
    if hit is None:
        return HoleCase(*known, False, "not found", *[nan] * 5)
    size_mm = 1e3 * (hit.diameter_m - mark.diameter_m)
    patch = hit.patch
    if patch.T_cam_target is None or patch.covariance is None:
        return HoleCase(*known, True, patch.status.value, nan, nan, size_mm, nan, nan)
    error = patch.T_cam_target[:3, 3] - T[:3, 3]
    axis = patch.T_cam_target[:3, 2]
    across = np.linalg.svd(axis[None])[2][1:]
    tilt = across @ np.cross(axis, T[:3, 2])
    C = patch.covariance
    return HoleCase(
        *known,
        True,
        patch.status.value,
        1e3 * float(np.linalg.norm(error)),
        float(np.rad2deg(np.linalg.norm(np.cross(axis, T[:3, 2])))),
        size_mm,
        float(error @ np.linalg.solve(C[3:, 3:], error)),
        float(tilt @ np.linalg.solve(across @ C[:3, :3] @ across.T, tilt)),
    )


def is_visible(machine: Machine, T_cam_mark: Array, radius_m: float, tool: tuple[list[Array], list[Array]]) -> bool:
    """Whether the whole rim is inside both pictures and beside the own tool."""
    angle = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    rim = radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(36)])
    size = [machine.camera.width_px, machine.camera.height_px]
    for pixels, polygons in zip(project_stereo(machine.camera, transform_points(T_cam_mark, rim)), tool, strict=True):
        if not (
            np.isfinite(pixels).all() and (pixels > MARGIN_PX).all() and (pixels < np.array(size) - MARGIN_PX).all()
        ):
            return False
        for polygon in polygons:
            contour = polygon.astype(np.float32).reshape(-1, 1, 2)
            if any(cv2.pointPolygonTest(contour, (float(u), float(v)), False) >= 0 for u, v in pixels):
                return False
    return True
