"""What every ObjectPoseSource owes, whatever it looks for; and a second source that has nothing to do with ArUco."""

import cv2
import numpy as np
from vision_scenes import deviation

from machine.camera import project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import transform_points
from server.vision.contracts import ObjectPose, ObjectPoseSource, PairObservation, PoseStatus
from server.vision.object_pose import NO_RIVAL_CHI2_MARGIN, not_seen
from server.vision.pose_refinement import PointObservations, distinct_minima


def check_contract(source: ObjectPoseSource, pair, truth, position_m: float, rotation_rad: float) -> PairObservation:
    """A pair that shows both objects, then pairs that show nothing."""
    observation = source.observe(*pair, 123_456_789)
    assert observation.t_exposure_ns == 123_456_789
    for name, found in (("tool", observation.tool), ("ooi", observation.ooi)):
        assert found.object_name == name
        assert found.status is PoseStatus.OK, found.reason
        error = deviation(found.T_cam_object, truth[name])
        assert np.linalg.norm(error[:3]) < rotation_rad, f"{name} [rad]"
        assert np.linalg.norm(error[3:]) < position_m, f"{name} [m]"
        assert found.covariance.shape == (6, 6)
        assert np.linalg.eigvalsh(found.covariance).min() > 0.0
    check_blind(source, pair[0].shape)
    return observation


def check_blind(source: ObjectPoseSource, shape) -> None:
    for image in (np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8), np.full(shape, 90, np.uint8)):
        blind = source.observe(image, image, 5)
        for found in (blind.tool, blind.ooi):
            assert found.status is PoseStatus.NOT_SEEN
            assert found.T_cam_object is None
            assert found.covariance is None
            assert found.reason


class DotPlateSource:
    """White dots on known places, told apart by their size: a stand-in for drill holes and tool rims."""

    def __init__(
        self, camera: StereoCamera, plates: dict[str, tuple[np.ndarray, float]], starts: dict[str, np.ndarray]
    ):
        self._camera, self._plates, self._starts = camera, plates, starts

    def observe(self, left, right, t_exposure_ns: int) -> PairObservation:
        tool, ooi = (self._find(name, left, right) for name in ("tool", "ooi"))
        return PairObservation(t_exposure_ns, tool, ooi, (), ())

    def _find(self, name, left, right) -> ObjectPose:
        points, radius_px = self._plates[name]
        expected = project_stereo(self._camera, transform_points(self._starts[name], points))
        seen = [self._dots(image, radius_px, near) for image, near in zip((left, right), expected, strict=True)]
        if any(places is None for places in seen):
            return not_seen(name, f"dots of the {name} are not in both eyes")
        rays = np.concatenate([undistort_to_rays(self._camera, places) for places in seen])
        focal = np.array([self._camera.fx_px, self._camera.fy_px])
        eye_x = np.repeat([0.0, self._camera.baseline_m], len(points))
        seen = PointObservations(np.tile(points, (2, 1)), rays * focal, eye_x, focal)
        (fit,) = distinct_minima(self._starts[name][None], seen, 0.01)
        rms = float(np.sqrt(np.mean(fit.residuals_px**2)))
        covariance = 0.1**2 * np.linalg.inv(fit.information)
        return ObjectPose(name, PoseStatus.OK, "", fit.T_cam_object, covariance, (), rms, NO_RIVAL_CHI2_MARGIN)

    @staticmethod
    def _dots(image, radius_px, near):
        count, _, stats, middles = cv2.connectedComponentsWithStats((image > 127).astype(np.uint8))
        area = np.pi * radius_px**2
        wanted = [k for k in range(1, count) if 0.7 * area < stats[k, cv2.CC_STAT_AREA] < 1.3 * area]
        if len(wanted) < len(near):
            return None
        found = middles[wanted]
        return np.array([found[np.argmin(np.linalg.norm(found - place, axis=1))] for place in near])


def draw_dots(camera: StereoCamera, truth, plates) -> tuple[np.ndarray, np.ndarray]:
    """A dark pair with the plates' dots as sub-pixel discs."""
    images = []
    for eye in range(2):
        image = np.zeros((camera.height_px, camera.width_px), np.uint8)
        for name, (points, radius_px) in plates.items():
            for x, y in project_stereo(camera, transform_points(truth[name], points))[eye]:
                centre = (round(x * 256), round(y * 256))
                cv2.circle(image, centre, round(radius_px * 256), 255, -1, cv2.LINE_AA, shift=8)
        images.append(image)
    return images[0], images[1]
