"""Every dictionary of OpenCV: one corner order, the right id and pose, and the machine file knows its size."""

import cv2
import numpy as np
import pytest
from vision_prints import photographed, printed
from vision_scenes import deviation, facing_pose, machine

from machine.camera import project_stereo
from machine.description import Marker
from machine.marker_sections import dictionary_size
from machine.markers import marker_corners
from machine.poses import transform_points
from server.vision.edge_fit import SideFit
from server.vision.marker_search import dictionary_by_name, dictionary_names, find_markers, refined_marker
from server.vision.object_pose import PoseSettings, estimate_object_pose
from server.vision.pose_problem import Sighting

NAMES = dictionary_names()


def test_all_families_are_there():
    families = {name.upper() for name in NAMES}
    assert len(families) == 22
    for wanted in ("APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", "APRILTAG_36H11", "ARUCO_ORIGINAL"):
        assert f"DICT_{wanted}" in families
    assert "DICT_ARUCO_MIP_36H12" in families


@pytest.mark.parametrize("name", NAMES)
def test_the_machine_file_knows_how_many_ids_a_dictionary_has(name):
    assert dictionary_size(name) == len(dictionary_by_name(name).bytesList)


@pytest.mark.parametrize("name", NAMES)
def test_a_printed_marker_is_found_with_id_corner_order_and_pose(name):
    """Drawn by the renderer, warped by a known pose and the lens into both eyes."""
    dictionary = dictionary_by_name(name)
    rng = np.random.default_rng(len(name))
    size = len(dictionary.bytesList)
    marker = Marker(int(rng.integers(size)), 0.12, "ooi", np.eye(4))
    T_cam_marker = facing_pose(0.5, 30.0, 50.0 + 10.0 * size % 300.0, (0.05, -0.04))
    images = photographed(printed(name, marker), T_cam_marker, rng)
    truth = project_stereo(machine().camera, transform_points(T_cam_marker, marker_corners(marker.side_m)))
    seen = []
    for image, corners in zip(images, truth, strict=True):
        (found,) = (one for one in find_markers(image, dictionary) if one.marker_id == marker.marker_id)
        assert np.abs(found.corners_px - corners).max() < 1.5, "px: same corner first, same way round"
        fine = refined_marker(found, image, dictionary, machine().camera)
        assert fine.side_fit is SideFit.CLEAN
        assert np.abs(fine.corners_px - corners).max() < 0.1, "px"
        seen.append(fine.corners_px)
    pose, _ = estimate_object_pose("ooi", (Sighting(marker, *seen),), machine().camera, PoseSettings())
    assert pose.T_cam_object is not None
    apart = deviation(pose.T_cam_object, T_cam_marker)
    assert np.rad2deg(np.linalg.norm(apart[:3])) < 0.3
    assert 1e3 * np.linalg.norm(apart[3:]) < 0.5


@pytest.mark.parametrize("name", NAMES)
def test_the_drawing_has_the_first_corner_at_the_top_left(name):
    """OpenCV's own drawing, unwarped: whatever a family's home may call its first corner, here it is one order."""
    dictionary = dictionary_by_name(name)
    image = np.full((200, 200), 255, np.uint8)
    image[40:160, 50:170] = cv2.aruco.generateImageMarker(dictionary, 1, 120)
    (found,) = find_markers(image, dictionary)
    expected = np.array([[49.5, 39.5], [169.5, 39.5], [169.5, 159.5], [49.5, 159.5]])
    assert found.marker_id == 1
    assert np.abs(found.corners_px - expected).max() < 1.5
