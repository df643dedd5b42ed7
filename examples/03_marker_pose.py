"""The pose of a marker from a stereo pair: a printed marker, drawn into both eyes, and found again."""

import cv2
import numpy as np

import longreach
from machine.poses import inverse_pose

machine = longreach.read_machine("hiab033")
camera, marker = machine.camera, machine.markers_on("ooi")[0]
T_cam_marker = np.eye(4)
T_cam_marker[:3, :3] = np.diag([1.0, -1.0, -1.0])  # it faces the camera
T_cam_marker[:3, 3] = (0.05, 0.02, 0.9)

PIXELS = 400
dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{machine.dictionary.removeprefix('DICT_')}"))
print_ = np.full((PIXELS + 200, PIXELS + 200), 255, np.uint8)  # with the white margin that a marker needs
print_[100:-100, 100:-100] = cv2.aruco.generateImageMarker(dictionary, marker.marker_id, PIXELS)
half = 0.5 * marker.side_m
corners_marker = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
edge = 100.0 + PIXELS - 0.5
corners_print = np.array([[99.5, 99.5], [edge, 99.5], [edge, edge], [99.5, edge]], dtype=np.float32)

pair = []
for x_m in (0.0, camera.baseline_m):  # left eye, right eye
    seen = corners_marker @ T_cam_marker[:3, :3].T + T_cam_marker[:3, 3] - (x_m, 0.0, 0.0)
    pixels = seen @ camera.matrix.T
    onto = cv2.getPerspectiveTransform(corners_print, (pixels[:, :2] / pixels[:, 2:]).astype(np.float32))
    size = (camera.width_px, camera.height_px)
    pair.append(cv2.GaussianBlur(cv2.warpPerspective(print_, onto, size, borderValue=140), (0, 0), 0.8))

seen = longreach.ArucoPoseSource(machine).observe(pair[0], pair[1], t_exposure_ns=0)
print("object of interest:", seen.ooi.status.value, seen.ooi.reason)
if seen.ooi.T_cam_object is not None:
    T_cam_seen = seen.ooi.T_cam_object @ marker.T_on_marker
    error = (inverse_pose(T_cam_marker) @ T_cam_seen)[:3, 3]
    print(f"marker {marker.marker_id}: {1e3 * np.linalg.norm(error):.2f} mm from where it was drawn")
