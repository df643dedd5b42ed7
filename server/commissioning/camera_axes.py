"""Step: the camera sees the tool's motion the way the machine makes it: no axis swapped, no eye exchanged."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path

import numpy as np

from machine.kinematics import tcp_pose
from machine.poses import inverse_pose, pose
from machine.rotations import Array
from recording.files import read_text, write_durably
from server.camera.errors import CameraError
from server.camera.own_structure import UNMASKED_AREA_MIN_FRAC, Masks, draw_mask, mask_line, uncovered_frac
from server.commissioning.contracts import Figure, StepResult, result_of_figures
from server.commissioning.looking import camera_of, disparities_px, fresh_pairs, mean_pose
from server.commissioning.moving import (
    MachineReading,
    NotReadyError,
    arm_if_needed,
    play_gently,
    require_leave,
    run_trajectory,
    wait_for_rest,
)
from server.commissioning.site import Site
from server.motion.contracts import JointTrajectory
from server.motion.point_to_point import plan_move
from server.motion.settings import PlanSettings
from server.vision.contracts import Image

# Which way the camera really looks: seen displacements against expected ones, a wrong mounting in words. Pure.

DIRECTION_ERROR_MAX_DEG = 25.0  # as far as calibration may correct the nominal mounting
RATIO_MIN, RATIO_MAX = 0.8, 1.25  # of lengths: baseline, focal length
DEPTH_SCALE_ERROR_MAX_FRAC = 0.03  # 3 sigma: legs of 80 mm to 0.5 mm, and 0.5 % of uncalibrated kinematics
_CLEARLY = 0.7  # the best wrong mounting must fit this well before it is named
_AXES = ("right", "down", "forward")
_Rows = tuple[tuple[int, int], ...]  # of a signed permutation: source axis and sign
_KNOWN: dict[_Rows, str] = {
    ((0, -1), (1, -1), (2, 1)): "the camera is mounted upside down (turned by 180 deg about its line of sight)",
    ((0, -1), (1, 1), (2, 1)): "left and right are mirrored or swapped",
    ((0, 1), (1, -1), (2, 1)): "the pictures are flipped top to bottom",
    ((0, -1), (1, 1), (2, -1)): "the camera looks backwards",
    ((1, 1), (0, -1), (2, 1)): "the camera is turned by 90 deg about its line of sight",
    ((1, -1), (0, 1), (2, 1)): "the camera is turned by -90 deg about its line of sight",
}


@dataclass(frozen=True, slots=True)
class CameraDisplacements:
    """Camera displacements of some moves in the nominal camera's axes (k, 3) [m]: by kinematics, and as seen."""

    measured_by: str
    expected_m: Array
    seen_m: Array


def axes_figures(seen: CameraDisplacements, legs: list[str]) -> list[Figure]:
    """Angle and length of every seen displacement against the expected one."""
    figures = []
    for leg, wanted, got in zip(legs, seen.expected_m, seen.seen_m, strict=True):
        length, got_length = float(np.linalg.norm(wanted)), float(np.linalg.norm(got))
        cosine = float(wanted @ got) / max(length * got_length, 1e-12)
        angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
        figures.append(
            Figure(
                f"{leg}, by {seen.measured_by}: off the expected direction",
                angle,
                "deg",
                at_most=DIRECTION_ERROR_MAX_DEG,
            )
        )
        ratio = got_length / max(length, 1e-12)
        figures.append(
            Figure(f"{leg}, by {seen.measured_by}: measured length", ratio, "of expected", RATIO_MIN, RATIO_MAX)
        )
    return figures


def depth_figure(seen: CameraDisplacements) -> list[Figure]:
    """Depth seen against sideways seen, each over the encoders' way: the common focal length over its file's, inverted.

    Model:   depth is f b / disparity and sideways is free of f, so their ratio alone shows a focal length that is off
             alike in both eyes. None without a leg along depth and one across.
    """
    ratios = np.linalg.norm(seen.seen_m, axis=1) / np.maximum(np.linalg.norm(seen.expected_m, axis=1), 1e-12)
    along = np.abs(seen.expected_m[:, 2]) > np.linalg.norm(seen.expected_m[:, :2], axis=1)
    if along.all() or not along.any():
        return []
    value = float(np.mean(ratios[along]) / np.mean(ratios[~along]))
    limits = 1.0 - DEPTH_SCALE_ERROR_MAX_FRAC, 1.0 + DEPTH_SCALE_ERROR_MAX_FRAC
    return [Figure(f"depth against sideways, by {seen.measured_by} (focal length)", value, "of expected", *limits)]


def wrong_mounting(seen: CameraDisplacements) -> str:
    """What signed permutation of the axes explains what was seen, in words; empty: none, or none is needed.

    Model:   the P among the 48 signed permutations that maximises sum (P expected) . seen over the product of lengths.
    """
    best, fit = _best_permutation(seen.expected_m, seen.seen_m)
    if fit < _CLEARLY or best == ((0, 1), (1, 1), (2, 1)):
        return ""
    exchanged = "; ".join(f"{_AXES[i]} shows as {_signed_axis_name(best, i)}" for i in range(3) if best[i] != (i, 1))
    return _KNOWN.get(best, f"the camera's axes are exchanged: {exchanged}")


def _signed_axis_name(best: _Rows, axis: int) -> str:
    """As what a nominal axis shows in the real camera."""
    for row, (source, sign) in enumerate(best):
        if source == axis:
            return ("" if sign > 0 else "minus ") + _AXES[row]
    raise ValueError(f"axis {axis} is in no row of {best}")


def _best_permutation(expected: Array, seen: Array) -> tuple[_Rows, float]:
    """Rows (source axis, sign) of the best signed permutation, and its mean cosine."""
    norm = float(np.linalg.norm(expected, axis=1) @ np.linalg.norm(seen, axis=1))
    scored = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        turned = expected[:, order] * np.array(signs)
        scored.append((float(np.sum(turned * seen)) / max(norm, 1e-12), tuple(zip(order, signs, strict=True))))
    fit, rows = max(scored, key=lambda each: each[0])
    return rows, fit


CAMERA_AXES_STEP_NAME = "camera axes"
CAMERA_AXES_REMEDY = (
    "correct the mounting, exchange the eyes, or correct T_tcp_cam_left in the machine file; where only depth is off, "
    "calibrate the camera (focal length); then run this step again"
)
TEST_LEG_LENGTHS_M = (0.08, 0.05)
PAIRS_PER_LOOK = 10
LEG_PLAN_SETTINGS = PlanSettings(speed_scale=0.5, shape_reference=False)
_LEGS = (("camera right", (1.0, 0.0, 0.0)), ("camera down", (0.0, 1.0, 0.0)), ("camera back", (0.0, 0.0, -1.0)))


# Masks over the machine itself: what stood still in both eyes' pictures while the tool moved, into the settings.

EYE_NAMES = ("left", "right")
Still = tuple[Image | None, Image | None]


async def propose_masks(site: Site, seen: Sequence[Still], masks: Masks) -> str:
    """What the step's report says of the masks; written into the settings file where there is one and leave is given.

    Args:    seen: of each leg, what stood still in the left and the right eye. masks: of the settings.
    """
    wanted = masks_wanted(seen, masks)
    if wanted is None:
        return "no leg moved both images enough to detect the machine's own structure"
    shares = [100.0 * uncovered_frac(mask, polygons) for mask, polygons in zip(wanted, masks, strict=True)]
    found = f"{shares[0]:.0f} % of the left and {shares[1]:.0f} % of the right picture move with the camera unmasked"
    if max(shares) < 100.0 * UNMASKED_AREA_MIN_FRAC:
        return found
    lines = {f"mask_{eye}": mask_line(eye, mask) for eye, mask in zip(EYE_NAMES, wanted, strict=True)}
    by_hand = f"{found}; put into [camera] of the settings: {' '.join(lines.values())}"
    file = site.options.settings_file
    if file is None or not await site.operator.confirm(f"{found}: masks over it will be written into {file}"):
        return by_hand
    if not _write_camera_lines(file, lines, site.settings.camera.kind):
        return by_hand
    return f"{found}; masks over it are in {file} now, for the next start of the server"


def masks_wanted(seen: Sequence[Still], masks: Masks) -> tuple[Image, Image] | None:
    """Masks (h, w), 255 over what stood still in every leg that moved the picture, and over what is masked already.

    Returns: None where no leg moved an eye's picture.
    """
    found: list[Image] = []
    for eye, polygons in enumerate(masks):
        masked = [mask for still in seen if (mask := still[eye]) is not None]
        if not masked:
            return None
        found.append(np.asarray(np.minimum.reduce(masked) | draw_mask(masked[0].shape, polygons), np.uint8))
    return found[0], found[1]


def _write_camera_lines(file: Path, lines: dict[str, str], kind: str) -> bool:
    """Whether the lines are in the file's [camera] now, and nothing else in it has changed."""
    try:
        before = read_text(file)
        after = with_camera_lines(before, lines, kind)
        expected = tomllib.loads(before)
        expected.setdefault("camera", {"kind": kind}).update(tomllib.loads("\n".join(lines.values())))
        if tomllib.loads(after) != expected:
            return False
        write_durably(file, after)
    except (OSError, tomllib.TOMLDecodeError):
        return False
    return True


def with_camera_lines(text: str, lines: dict[str, str], kind: str) -> str:
    """A settings file's text with these lines, by their key, at the top of its [camera] in place of those it had."""
    for key in lines:
        text = re.sub(rf"(?m)^[ \t]*{key}[ \t]*=.*\n?", "", text)
    new = "\n".join(lines.values())
    header = re.search(r"(?m)^[ \t]*\[camera\][^\n]*$", text)
    if header is None:
        return f'{text.rstrip()}\n\n[camera]\nkind = "{kind}"\n{new}\n'.lstrip()
    return f"{text[: header.end()]}\n{new}{text[header.end() :]}"


@dataclass(frozen=True, slots=True)
class CameraMove:
    """One move: the camera's displacement in its nominal axes by kinematics, by odometry and by the OOI's markers."""

    name: str
    expected_m: Array
    odometry_m: Array | None
    markers_m: Array | None


async def camera_axes(site: Site) -> StepResult:
    """Move the tool a little along the camera's three nominal axes, and compare."""
    await require_leave(site, "the tool will now move by 80 mm to the side, up or down, and back, slowly")
    await arm_if_needed(site)
    before = await fresh_pairs(site, PAIRS_PER_LOOK, "looking before the moves")
    legs, unmeasured, still = [], [], []
    for name, axis in _LEGS:
        try:
            leg, still_here = await _observe_axis_move(site, name, np.array(axis))
        except CameraError as error:
            unmeasured.append(f"{name}: {error}")
        else:
            legs.append(leg)
            still.append(still_here)
    result = judge_axes(legs, unmeasured, disparities_px(before))
    return replace(result, notes=(*result.notes, await propose_masks(site, still, camera_of(site).masks)))


def judge_axes(legs: Sequence[CameraMove], unmeasured: Sequence[str], disparities: Sequence[float]) -> StepResult:
    """The result for the legs driven, those that could not be measured, and the markers' disparities [px]."""
    figures, missing = [], list(unmeasured)
    notes: list[str] = []
    mountings: list[str] = []
    if disparities:
        figures.append(Figure("disparity of the markers", float(np.median(disparities)), "px", at_least=1.0))
    else:
        missing.append("no marker was visible in both eyes, so whether they are exchanged is not checked")
    for by, steps in (("odometry", [leg.odometry_m for leg in legs]), ("OOI markers", [leg.markers_m for leg in legs])):
        measured = [(leg, step) for leg, step in zip(legs, steps, strict=True) if step is not None]
        if not measured:
            notes.append(f"{by} measured nothing")
            continue
        seen = CameraDisplacements(
            by, np.array([leg.expected_m for leg, _ in measured]), np.array([step for _, step in measured])
        )
        figures += axes_figures(seen, [leg.name for leg, _ in measured]) + depth_figure(seen)
        mounting = wrong_mounting(seen) if len(measured) == len(_LEGS) else ""
        mountings += [f"by {by}: {mounting}"] if mounting else []
    missing += [
        f"{leg.name}: neither odometry nor markers measured it"
        for leg in legs
        if leg.odometry_m is leg.markers_m is None
    ]
    result = result_of_figures(
        CAMERA_AXES_STEP_NAME,
        figures,
        "the camera sees the moves as the machine makes them",
        CAMERA_AXES_REMEDY,
        missing,
        notes,
    )
    return replace(result, summary="; ".join([*mountings, result.summary])) if mountings else result


async def _observe_axis_move(site: Site, name: str, axis_cam: Array) -> tuple[CameraMove, Still]:
    """There, look, back; what stood still in the pictures meanwhile."""
    vision = camera_of(site)
    start = await wait_for_rest(site)
    trajectory = _camera_axis_trajectory(site, start, name, axis_cam)
    seen_before = mean_pose(
        [report.observation.ooi for report in await fresh_pairs(site, PAIRS_PER_LOOK, f"{name}: before")]
    )
    try:
        await vision.start_odometry(masks=True)
        played = await run_trajectory(site, trajectory, name)
        end = await wait_for_rest(site)
        pairs = await fresh_pairs(site, PAIRS_PER_LOOK, f"{name}: after")
        track = await vision.stop_odometry()
        odometry_map = await vision.odometry_map()
    finally:
        vision.drop_odometry()
    seen_after = mean_pose([report.observation.ooi for report in pairs])
    await play_gently(site, start.q_ref, f"{name}: back")
    if not played.motion_end.reached:
        raise NotReadyError(f"{name}: motion ended early: {played.motion_end.reason}")
    step = expected_step(site, start, end)
    leg = CameraMove(name, step, _odometry_step(track.Ts_vo_cam), marker_step(seen_before, seen_after))
    return leg, (None, None) if odometry_map is None else odometry_map.still_masks


def _camera_axis_trajectory(site: Site, start: MachineReading, name: str, axis_cam: Array) -> JointTrajectory:
    """A straight move along a nominal camera axis, to whichever side is possible."""
    T = tcp_pose(site.chain, start.q_ref)
    axis_base = T[:3, :3] @ site.machine.T_tcp_cam_left[:3, :3] @ axis_cam
    reason = ""
    for length_m in TEST_LEG_LENGTHS_M:
        for sign in (1.0, -1.0) if axis_cam[2] == 0.0 else (1.0,):
            plan = plan_move(
                site.machine, start.q_ref, pose(T[:3, :3], T[:3, 3] + sign * length_m * axis_base), LEG_PLAN_SETTINGS
            )
            if plan.trajectory is not None:
                return plan.trajectory
            reason = reason or plan.reason
    raise NotReadyError(f"{name}: no move of {1e3 * TEST_LEG_LENGTHS_M[-1]:.0f} mm is possible from here: {reason}")


def expected_step(site: Site, start: MachineReading, end: MachineReading) -> Array:
    """The camera's displacement by kinematics in the nominal camera's axes at the start (3,) [m]."""
    T_base_start = tcp_pose(site.chain, start.q_rad) @ site.machine.T_tcp_cam_left
    T_base_end = tcp_pose(site.chain, end.q_rad) @ site.machine.T_tcp_cam_left
    return (inverse_pose(T_base_start) @ T_base_end)[:3, 3]


def _odometry_step(Ts_vo_cam: Array) -> Array | None:
    """The camera's displacement by its odometry; its start frame is the camera itself (3,) [m]."""
    return (inverse_pose(Ts_vo_cam[0]) @ Ts_vo_cam[-1])[:3, 3] if len(Ts_vo_cam) > 1 else None


def marker_step(T_before: Array | None, T_after: Array | None) -> Array | None:
    """The camera's displacement by a thing that stands still, its turn held, seen before and after (3,) [m]."""
    if T_before is None or T_after is None:
        return None
    return T_before[:3, 3] - T_after[:3, 3]
