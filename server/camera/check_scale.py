"""Are the rig's scale, its focal length and the prints right? By markers in both eyes and by a taped distance. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine.camera import undistort_to_rays
from machine.description import Machine, StereoCamera
from machine.rotations import Array
from machine.targets import Marker
from server.calibration.joint_lens import FOCAL, LensPrior, look_sensitivity
from server.calibration.lens_evidence import LensEvidence, lens_doubts, lens_evidence, mean_evidence
from server.camera.check_findings import CheckFinding, Level, level_by_limits
from server.vision.contracts import PairObservation
from server.vision.errors import NoPoseError

SIGMA_CORNER_PX = 0.1  # of one corner coordinate; real print and lens included
SIGMA_PRINTED_SIDE_FRAC = 0.003  # of a printed side as a ruler measures it
WARN_FRAC, FAIL_FRAC = 0.015, 0.03
SIGNIFICANCE_SIGMAS = 3.0
ROW_OFFSET_MAX_PX = 8.0  # beyond it the two corners cannot be one


@dataclass(frozen=True, slots=True)
class SideRatio:
    """A marker's mean side as triangulated, over its printed one, with the standard deviation of that ratio."""

    marker_id: int
    measured_over_printed: float
    ratio_sigma: float
    distance_m: float


def side_ratio(camera: StereoCamera, marker: Marker, left_px: Array, right_px: Array) -> SideRatio | None:
    """None where the eyes' corners cannot belong together, or lie behind the camera."""
    left, right = undistort_to_rays(camera, left_px), undistort_to_rays(camera, right_px)
    disparity = left[:, 0] - right[:, 0]
    rows_px = camera.fy_px * np.abs(np.median(left[:, 1] - right[:, 1]))
    if disparity.min() <= 0.0 or rows_px > ROW_OFFSET_MAX_PX:
        return None
    z = float(camera.baseline_m / disparity.mean())
    # The corners' own depths are noisy; a plane's inverse depth is linear in the ray, 1/z = a + b x + c y.
    A = np.column_stack([np.ones(4), left])
    inverse = A @ np.linalg.lstsq(A, disparity / camera.baseline_m, rcond=None)[0]
    if inverse.min() <= 0.0:
        return None
    points = np.column_stack([left, np.ones(4)]) / inverse[:, None]
    sides = np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1)
    disparity_px = camera.fx_px * float(disparity.mean())
    sigma = float(np.hypot(SIGMA_CORNER_PX * np.sqrt(2.0 / 4.0) / disparity_px, SIGMA_PRINTED_SIDE_FRAC))
    return SideRatio(marker.marker_id, float(sides.mean()) / marker.side_m, sigma, z)


def side_ratios(
    camera: StereoCamera, markers: Mapping[int, Marker], seen: Sequence[PairObservation]
) -> list[SideRatio]:
    """Of every marker that both eyes see, pair by pair."""
    ratios = []
    for observation in seen:
        for view in observation.marker_views:
            if view.marker_id in markers and view.corners_left_px is not None and view.corners_right_px is not None:
                one = side_ratio(camera, markers[view.marker_id], view.corners_left_px, view.corners_right_px)
                ratios += [] if one is None else [one]
    return ratios


def check_scale(ratios: Sequence[SideRatio]) -> CheckFinding:
    """Finding `scale`. One marker off among others that agree is a wrong side; all off alike is the rig."""
    if not ratios:
        remedy = "show a marker of known side to both eyes"
        return CheckFinding("scale", Level.WARN, "inconclusive: no marker visible in both eyes", remedy)
    ids = sorted({ratio.marker_id for ratio in ratios})
    per_marker = {
        i: float(np.median([ratio.measured_over_printed for ratio in ratios if ratio.marker_id == i])) for i in ids
    }
    off = float(np.median(list(per_marker.values()))) - 1.0
    sigma = float(np.median([ratio.ratio_sigma for ratio in ratios])) / np.sqrt(len(ids))
    figures = {"scale_off_frac": off, "scale_sigma_frac": sigma} | {
        f"marker_{i}_ratio": r for i, r in per_marker.items()
    }
    level = level_by_limits(abs(off), WARN_FRAC, FAIL_FRAC) if abs(off) > SIGNIFICANCE_SIGMAS * sigma else Level.OK
    text = f"markers measure {100 * off:+.2f} +- {100 * sigma:.2f} % against their printed sides ({len(ids)} markers)"
    if level is not Level.OK:
        remedy = "measure the printed sides; if they are right, baseline or yaw of the eyes is off: calibrate the rig"
        return CheckFinding("scale", level, text, remedy, figures)
    odd = [
        i
        for i, ratio in per_marker.items()
        if abs(ratio - 1.0 - off) > max(WARN_FRAC, SIGNIFICANCE_SIGMAS * sigma * np.sqrt(len(ids)))
    ]
    if odd:
        remedy = f"measure the printed side of marker {odd[0]} again"
        return CheckFinding("scale", Level.WARN, f"{text}; marker {odd[0]} alone is off", remedy, figures)
    return CheckFinding("scale", Level.OK, text, "", figures)


SIGMA_TAPE_M = 1e-3  # of a distance read off a tape between two printed markers
# What the settings take for granted, `sigma_focal_frac`: known less well, it is unchecked
FOCAL_SIGMA_CHECKED_FRAC = 0.01
FOCAL_FAIL_FRAC = 0.03  # a focal length further off is another camera's, or of another image size
UNINFORMED_LENS_PRIOR = LensPrior(
    sigma_focal_frac=0.3
)  # the check takes nothing for granted: also another camera's file is found


@dataclass(frozen=True, slots=True)
class Tape:
    """Distance between the origins of tool and OOI as a tape shows it [m]."""

    distance_m: float


def check_focal(machine: Machine, seen: Sequence[PairObservation], tape: Tape | None = None) -> CheckFinding:
    """Finding `focal`: focal length and prints by perspective, stereo and tape. What none of them shows to
    FOCAL_SIGMA_CHECKED_FRAC stays OK, called unchecked."""
    looks = [(*poses, pair) for pair in seen if (poses := _tool_and_ooi_poses(pair)) is not None]
    if not looks:
        remedy = "show tool and OOI to both eyes, one marker tilted by 45 deg"
        return CheckFinding("focal", Level.WARN, "tool and OOI not seen together: not checked", remedy)
    evidence = mean_evidence(
        [
            lens_evidence(machine, tool, ooi, _used_marker_corners(pair), UNINFORMED_LENS_PRIOR)
            for tool, ooi, pair in looks
        ]
    )
    information = evidence.information + np.diag(UNINFORMED_LENS_PRIOR.sigma**-2.0)
    vector = evidence.information_vector
    if tape is not None:
        taped = mean_evidence([_of_tape(machine, tool, ooi, tape) for tool, ooi, _ in looks])
        information, vector = information + taped.information, vector + taped.information_vector
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    lens = covariance @ vector
    off, sigma = float(lens[FOCAL]), float(np.sqrt(covariance[FOCAL, FOCAL]))
    doubts = lens_doubts(lens, covariance, UNINFORMED_LENS_PRIOR)
    by = "perspective and tape" if tape is not None else "perspective"
    text = f"focal length {100 * off:+.2f} +- {100 * sigma:.2f} % against the file, by {by} of {len(looks)} pairs"
    figures = {"focal_off_frac": off, "focal_sigma_frac": sigma}
    if not doubts and sigma > FOCAL_SIGMA_CHECKED_FRAC:
        text += (
            f"; unchecked to {100 * FOCAL_SIGMA_CHECKED_FRAC:g} %: tape the distance from tool to OOI, and give it by "
            "--tape"
        )
    if not doubts:
        return CheckFinding("focal", Level.OK, text, "", figures)
    level = Level.FAIL if abs(off) > FOCAL_FAIL_FRAC + 3.0 * sigma else Level.WARN
    return CheckFinding("focal", level, text, "; ".join(doubts), figures)


def _tool_and_ooi_poses(observation: PairObservation) -> tuple[Array, Array] | None:
    tool, ooi = observation.tool.T_cam_object, observation.ooi.T_cam_object
    return None if tool is None or ooi is None else (tool, ooi)


def _used_marker_corners(observation: PairObservation) -> dict[int, tuple[Array | None, Array | None]]:
    return {
        view.marker_id: (view.corners_left_px, view.corners_right_px) for view in observation.marker_views if view.used
    }


def _of_tape(machine: Machine, T_cam_tool: Array, T_cam_ooi: Array, tape: Tape) -> LensEvidence:
    """One more equation: measured less taped distance = d distance / d lens, lens."""
    way = T_cam_ooi[:3, 3] - T_cam_tool[:3, 3]
    distance = float(np.linalg.norm(way))
    if distance < SIGMA_TAPE_M:
        raise NoPoseError("tool and OOI coincide; move them apart before taping a distance")
    S = look_sensitivity(machine, T_cam_tool, T_cam_ooi)
    g = (S[9:12] - S[3:6]).T @ (way / distance)
    weight = SIGMA_TAPE_M**-2.0
    return LensEvidence(weight * np.outer(g, g), weight * g * (distance - tape.distance_m))
