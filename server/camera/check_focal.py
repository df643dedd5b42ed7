"""Are focal length and prints right? By the corners of all markers, and by one taped distance. Pure.

Both eyes agree with each other whatever their common focal length is: only depth is stretched. What shows it is the
perspective of tilted markers of known size, or a known distance in depth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from server.calibration.joint_lens import FOCAL, LensPrior, look_sensitivity
from server.calibration.lens_evidence import LensEvidence, lens_doubts, lens_evidence, mean_evidence
from server.camera.check_findings import CheckFinding, Level
from server.vision.contracts import PairObservation
from server.vision.errors import NoPoseError

SIGMA_TAPE_M = 1e-3  # of a distance read off a tape between two printed markers
FAIL_FRAC = 0.03  # a focal length further off is another camera's, or of another image size
UNKNOWN = LensPrior(sigma_focal_frac=0.3)  # the check takes nothing for granted: also another camera's file is found


@dataclass(frozen=True, slots=True)
class Tape:
    """Distance between the origins of tool and OOI as a tape shows it [m]."""

    distance_m: float


def check_focal(machine: Machine, seen: Sequence[PairObservation], tape: Tape | None = None) -> CheckFinding:
    """Finding `focal`: focal length and prints by perspective, stereo and tape; what none of them shows stays OK with
    its sigma, which the settings' `sigma_focal_frac` should hold."""
    looks = [(*poses, pair) for pair in seen if (poses := _poses(pair)) is not None]
    if not looks:
        remedy = "show tool and OOI to both eyes, one marker tilted by 45 deg"
        return CheckFinding("focal", Level.WARN, "tool and OOI not seen together: not checked", remedy)
    evidence = mean_evidence([lens_evidence(machine, tool, ooi, _corners(pair), UNKNOWN) for tool, ooi, pair in looks])
    information = evidence.information + np.diag(UNKNOWN.sigma**-2.0)
    vector = evidence.vector
    if tape is not None:
        taped = mean_evidence([_of_tape(machine, tool, ooi, tape) for tool, ooi, _ in looks])
        information, vector = information + taped.information, vector + taped.vector
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    lens = covariance @ vector
    off, sigma = float(lens[FOCAL]), float(np.sqrt(covariance[FOCAL, FOCAL]))
    doubts = lens_doubts(lens, covariance, UNKNOWN)
    by = "perspective and tape" if tape is not None else "perspective"
    text = f"focal length {100 * off:+.2f} +- {100 * sigma:.2f} % against the file, by {by} of {len(looks)} pairs"
    figures = {"focal_off_frac": off, "focal_sigma_frac": sigma}
    if not doubts:
        return CheckFinding("focal", Level.OK, text, "", figures)
    level = Level.FAIL if abs(off) > FAIL_FRAC + 3.0 * sigma else Level.WARN
    return CheckFinding("focal", level, text, "; ".join(doubts), figures)


def _poses(observation: PairObservation) -> tuple[Array, Array] | None:
    tool, ooi = observation.tool.T_cam_object, observation.ooi.T_cam_object
    return None if tool is None or ooi is None else (tool, ooi)


def _corners(observation: PairObservation) -> dict[int, tuple[Array | None, Array | None]]:
    return {view.marker_id: (view.corners_left_px, view.corners_right_px) for view in observation.views if view.used}


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
