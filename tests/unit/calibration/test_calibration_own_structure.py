"""Local calibration with the crane's own structure in the picture: rendered path, odometry, trajectory matching."""

import numpy as np
import pytest

from benchmarks.vision.odometry.film import FilmCase, nominal_machine, render_film
from machine.poses import inverse_pose
from machine.rotations import geodesic_angle
from server.calibration.contracts import CalibrationStatus, CameraTrack, EncoderTrack
from server.calibration.trajectory_matching import estimate_camera_rotation
from server.vision.contracts import OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry

RATE_HZ = 6.0  # few pairs, long steps: the structure is a quarter of the picture from the first one on


@pytest.mark.parametrize("texture", [1.0, 0.15], ids=["textured", "plain"])
def test_a_path_with_a_quarter_of_the_picture_covered_calibrates(texture):
    case = FilmCase("circle", 1.3, 4, RATE_HZ, structure_frac=0.25, structure_contrast_frac=texture)
    film, machine = render_film(case), nominal_machine()
    odometry = StereoOdometry(machine.camera, OdometrySettings(readout_s=film.readout_s))
    found = [odometry.process(*film.pair(k), t_ns) for k, t_ns in enumerate(film.t_exposure_ns)]
    errors_m = np.array(
        [np.linalg.norm(p.T_vo_cam[:3, 3] - T[:3, 3]) for p, T in zip(found, film.Ts_vo_cam, strict=True)]
    )
    ok = np.array([pose.status is OdometryStatus.OK for pose in found])
    assert errors_m[ok].max() < 2.5e-3
    assert ok[:3].all(), "at rest"
    assert ok.mean() > 0.9
    t_s, T_tcp_cam = 1e-9 * np.array(film.t_exposure_ns), machine.T_tcp_cam_left
    kept = np.array([pose.status is not OdometryStatus.LOST for pose in found])
    camera = CameraTrack(t_s=t_s[kept], Ts_vo_cam=np.array([pose.T_vo_cam for pose in found])[kept])
    encoders = EncoderTrack(t_s=t_s, Ts_base_tcp=T_tcp_cam @ film.Ts_vo_cam @ inverse_pose(T_tcp_cam))
    estimate = estimate_camera_rotation(camera, encoders, T_tcp_cam)
    assert estimate.status is CalibrationStatus.OK, estimate.reason
    assert estimate.R_tcp_cam is not None
    assert estimate.covariance is not None
    sigma_rad = np.sqrt(np.linalg.eigvalsh(estimate.covariance)[-1])
    error_rad = geodesic_angle(T_tcp_cam[:3, :3], estimate.R_tcp_cam)
    assert error_rad < 3.0 * sigma_rad
    assert np.rad2deg(error_rad) < 0.5
