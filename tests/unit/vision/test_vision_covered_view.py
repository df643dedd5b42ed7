"""A bright board in front of a marker's edge in one eye, against a marker that has moved on its board."""

from dataclasses import replace

import numpy as np
import pytest
from vision_scenes import deviation, facing_pose, machine, sight

from machine.rotations import rotation_from_rotvec
from server.vision.contracts import PoseStatus
from server.vision.object_pose import PoseSettings, estimate_object_pose
from server.vision.pose_problem import Sighting

CAMERA = machine().camera
OOI = machine().markers_on("ooi")


def cut_off(sighting: Sighting, eye: str, by_px: float) -> Sighting:
    """The lower edge of a marker in one eye taken for higher up, as where a white board covers it."""
    pixels = {"left": sighting.left_px, "right": sighting.right_px}[eye]
    assert pixels is not None
    lower = pixels.copy()
    lower[np.argsort(pixels[:, 1])[2:], 1] -= by_px
    return replace(sighting, left_px=lower) if eye == "left" else replace(sighting, right_px=lower)


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize("by_px", [4.0, 10.0])
def test_the_covered_view_is_left_out_and_said(eye: str, by_px: float) -> None:
    rng = np.random.default_rng(3)
    T_true = facing_pose(0.9, 20.0, 30.0, (0.1, -0.05))
    sightings = list(sight(OOI, T_true, rng, 0.05))
    sightings[0] = cut_off(sightings[0], eye, by_px)
    found, views = estimate_object_pose("ooi", sightings, CAMERA, PoseSettings())
    assert found.status is PoseStatus.OK
    assert f"marker {OOI[0].marker_id} is covered in the {eye} eye" in found.reason
    assert found.residual_rms_px < 0.1
    assert np.abs(deviation(found.T_cam_object, T_true)[3:]).max() < 1e-3
    seen = next(view for view in views if view.marker_id == OOI[0].marker_id)
    assert (seen.corners_left_px is None) == (eye == "left")
    assert (seen.corners_right_px is None) == (eye == "right")


def test_a_moved_marker_is_never_taken_for_a_covered_one() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        T_true = facing_pose(rng.uniform(0.5, 1.3), rng.uniform(0.0, 40.0), rng.uniform(0.0, 360.0))
        moved = np.eye(4)
        moved[:3, 3] = rng.normal(0.0, 1.0, 3) * rng.choice([0.002, 0.005, 0.01, 0.02])
        moved[:3, :3] = rotation_from_rotvec(rng.normal(0.0, 1.0, 3) * rng.choice([0.0, 0.03, 0.1]))
        which = rng.integers(len(OOI))
        elsewhere = replace(OOI[which], T_on_marker=OOI[which].T_on_marker @ moved)
        sightings = list(sight(OOI, T_true, rng, 0.05))
        sightings[which] = replace(sight([elsewhere], T_true, rng, 0.05)[0], marker=OOI[which])
        found, _ = estimate_object_pose("ooi", sightings, CAMERA, PoseSettings())
        assert "covered" not in found.reason


def test_a_single_marker_cannot_be_outvoted() -> None:
    rng = np.random.default_rng(7)
    sightings = list(sight(OOI[:1], facing_pose(0.9, 20.0, 30.0), rng, 0.05))
    found, _ = estimate_object_pose("ooi", [cut_off(sightings[0], "left", 6.0)], CAMERA, PoseSettings())
    assert "covered" not in found.reason
