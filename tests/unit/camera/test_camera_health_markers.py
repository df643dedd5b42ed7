"""What one target in both eyes contradicts: a print of another size, a cover, white that is cut off at the top."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from server.camera.health.findings import FaultCode
from server.camera.health.markers import MarkerMonitor
from server.settings import read_machine
from server.vision.contracts import MarkerView, ObjectPose, PoseStatus

CAMERA = read_machine("hiab033").camera
SQUARE = np.array([[60.0, 60.0], [160.0, 60.0], [160.0, 160.0], [60.0, 160.0]])
BOARD = np.column_stack([np.arange(24.0), np.arange(24.0)])
NOT_SEEN = ObjectPose("ooi", PoseStatus.NOT_SEEN, "no marker", None, None, (), 0.0, 0.0)


def checked(residual_px: float = 0.02, left=SQUARE, right=SQUARE, white: float = 230.0, blur_px: float = 0.8) -> Any:
    """Findings of a pair that shows one tool marker."""
    picture = np.full((220, 220), white)
    picture[60:160, 60:160] = 20.0
    image = np.clip(cv2.GaussianBlur(picture, (0, 0), blur_px), 0, 255).astype(np.uint8)
    view = MarkerView(10, left, right, residual_px, True, "")
    T = np.eye(4)
    T[2, 3] = 0.35
    tool = ObjectPose("tool", PoseStatus.OK, "", T, 1e-6 * np.eye(6), (10,), residual_px, float("inf"))
    pair: Any = SimpleNamespace(
        observation=SimpleNamespace(marker_views=(view,), tool=tool, ooi=NOT_SEEN),
        frame=SimpleNamespace(left=image, right=image),
    )
    return MarkerMonitor(CAMERA).check(pair)


def test_a_sound_marker_is_sound():
    assert checked() == ()


def test_one_marker_that_fits_no_pose_of_its_size_in_both_eyes_is_told():
    (found,) = checked(residual_px=0.64)
    assert found.code is FaultCode.MARKER_MOVED
    assert found.forbids_look
    assert "residual 0.64 px rms (limit 0.30 px)" in found.text
    assert "measure its side" in found.text


@pytest.mark.parametrize("eyes", [(SQUARE, None), (None, SQUARE), (BOARD, BOARD)])
def test_one_eye_fits_itself_and_a_board_has_a_residual_of_its_own(eyes):
    assert checked(residual_px=0.64, left=eyes[0], right=eyes[1]) == ()


@pytest.mark.parametrize(("white", "told"), [(250.0, False), (300.0, True), (400.0, True)])
def test_white_beside_a_side_that_is_cut_off_is_told(white, told):
    found = checked(white=white)
    assert bool(found) is told
    assert all(one.code is FaultCode.SATURATED and one.forbids_look for one in found)
    assert not told or "marker 10's white is over-exposed in the left eye" in found[0].text


def test_a_marker_at_the_pictures_edge_is_not_judged_by_what_is_outside():
    assert checked(white=300.0, left=SQUARE - 60.0, right=None) == ()
