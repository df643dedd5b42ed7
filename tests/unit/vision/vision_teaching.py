"""Views of marker layouts with known truth, for the tests of teaching."""

import numpy as np
from vision_scenes import machine

from machine.camera import project_stereo
from machine.description import Marker
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_about, rotation_from_rotvec
from server.vision.teach_contracts import TeachView


def looking_at(position_m, target_m=(0.0, 0.0, 0.0), roll_deg=0.0) -> np.ndarray:
    """T_cam_object of a left camera at a place on the object, looking at another; y_cam roughly down."""
    position, target = np.array(position_m, float), np.array(target_m, float)
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    T_object_cam = pose(np.column_stack([x, np.cross(z, x), z]), position)
    return inverse_pose(T_object_cam @ pose(rotation_about("z", np.deg2rad(roll_deg)), np.zeros(3)))


def ways(rng, n=12, distance_m=(0.7, 1.1), spread_deg=30.0) -> list[np.ndarray]:
    """T_cam_object of n views from directions up to `spread_deg` off the object's z axis."""
    views = []
    for k in range(n):
        off, round_ = np.deg2rad(spread_deg) * np.sqrt((k + 0.5) / n), 2.4 * k
        away = np.array([np.sin(off) * np.cos(round_), np.sin(off) * np.sin(round_), np.cos(off)])
        target = rng.uniform(-0.05, 0.05, 3) + np.array([0.0, 0.05, 0.0])
        views.append(looking_at(away * rng.uniform(*distance_m), target, rng.uniform(-15, 15)))
    return views


def seen_view(markers, T_cam_object, rng=None, sigma_px=0.0, hidden=(), camera=None) -> TeachView:
    """Corners of those markers that face the camera and lie in its picture, with Gaussian noise."""
    lens = camera or machine().camera
    eyes: tuple[dict, dict] = ({}, {})
    for marker in markers:
        T_cam_marker = T_cam_object @ marker.T_on_marker
        if marker.marker_id in hidden or T_cam_marker[2, 2] > -0.2:
            continue
        both = project_stereo(lens, transform_points(T_cam_marker, marker_corners(marker.side_m)))
        for eye, pixels in zip(eyes, both, strict=True):
            inside = np.all((pixels > 5) & (pixels < [lens.width_px - 6, lens.height_px - 6]))
            if inside:
                noise = rng.normal(0.0, sigma_px, (4, 2)) if rng is not None else 0.0
                eye[marker.marker_id] = pixels + noise
    return TeachView(*eyes)


def true_layout(rng, n=4, side_m=0.15, spread_m=0.22, shift_m=0.0, tilt_deg=20.0) -> tuple[Marker, ...]:
    """Markers round the origin, tilted any way; ids from 1."""
    markers = []
    for k in range(n):
        angle = 2 * np.pi * k / n
        place = spread_m * np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.1, 0.1)])
        turn = np.append(rng.normal(0.0, np.deg2rad(tilt_deg) / 2, 2), rng.uniform(-0.6, 0.6))
        T = pose(rotation_from_rotvec(turn), place + shift_m)
        markers.append(Marker(k + 1, side_m, "ooi", T))
    return tuple(markers)
