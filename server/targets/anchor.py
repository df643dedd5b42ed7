"""A measured patch becomes a target: anchored to landmarks of its surroundings, so that it can be found again."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from machine.camera import project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, transform_points
from server.targets.contracts import AnchoredTarget, Landmarks, PatchStatus, SurfacePatch, TargetSettings
from server.vision.contracts import Array, Image
from server.vision.odometry_features import allowed_masks
from server.vision.odometry_keyframe import triangulated
from server.vision.odometry_sight import ImageSight, StereoMatches

LANDMARK_CELL_PX = 22  # one landmark a cell: neighbours' patches of 15 px do not overlap; about 150 within reach
LANDMARKS_MIN = 24  # twice what a fix needs, so that half of them may be covered
PATCH_SAMPLES_MAX = 100


def anchor_target(
    target_id: int,
    patch: SurfacePatch,
    left: Image,
    right: Image,
    camera: StereoCamera,
    settings: TargetSettings,
    masks_px: tuple[Sequence[Array], Sequence[Array]] = ((), ()),
) -> AnchoredTarget | SurfacePatch:
    """The target with its landmarks, or the patch refused because nothing around it can be recognised.

    Args:    left, right: the raw pair the patch was measured in. masks_px: polygons (k, 2) [px] of own structure in the
             left and the right image; landmarks lie outside them.
    """
    if patch.T_cam_target is None or patch.covariance is None:
        return patch
    T_ref_target = patch.T_cam_target
    found = _match_surroundings(patch, left, right, camera, settings, masks_px)
    points, covariances = triangulated(camera, found, settings.sigma_px)
    near = np.linalg.norm(points - T_ref_target[:3, 3], axis=1) < settings.surroundings_m
    if near.sum() < LANDMARKS_MIN:
        reason = (
            f"Patch at ({patch.pixel[0]:.0f}, {patch.pixel[1]:.0f}) px has {near.sum()} landmarks within "
            f"{1e3 * settings.surroundings_m:.0f} mm (limit {LANDMARKS_MIN}); it could not be found again. "
            "Choose a place with more texture around it, or add light"
        )
        return replace(patch, status=PatchStatus.NO_SURROUNDINGS, reason=reason, T_cam_target=None, covariance=None)
    surroundings = landmarks_of(
        camera, T_ref_target, found.left_px[near], found.right_px[near], points[near], covariances[near]
    )
    return AnchoredTarget(
        target_id=target_id,
        patch=patch,
        T_ref_target=T_ref_target,
        covariance_target=_in_target_axes(patch),
        sigma_scale_frac=float(T_ref_target[2, 3]) * settings.sigma_disparity_px / (camera.fx_px * camera.baseline_m),
        reference_left=left.copy(),
        reference_right=right.copy(),
        surrounding_landmarks=surroundings,
        surface_landmarks=_surface_samples(patch, camera, T_ref_target),
    )


def _match_surroundings(
    patch: SurfacePatch,
    left: Image,
    right: Image,
    camera: StereoCamera,
    settings: TargetSettings,
    masks_px: tuple[Sequence[Array], Sequence[Array]],
) -> StereoMatches:
    """Corners around the patch, matched in both eyes."""
    if patch.T_cam_target is None:
        raise ValueError("the patch was refused; anchor measured patches only")
    both = allowed_masks((camera.height_px, camera.width_px), masks_px)
    radius_px = settings.surroundings_m * camera.fx_px / float(patch.T_cam_target[2, 3])
    disc = np.zeros_like(both[0])
    cv2.circle(disc, (round(patch.pixel[0]), round(patch.pixel[1])), round(radius_px), 255, -1)
    sight = ImageSight(left, right, (np.minimum(both[0], disc), both[1]), 0)
    count = camera.height_px * camera.width_px // LANDMARK_CELL_PX**2
    return sight.match_eyes(camera, count, np.zeros((0, 2)))


def landmarks_of(
    camera: StereoCamera, T_ref_target: Array, left_px: Array, right_px: Array, points_cam: Array, covariances: Array
) -> Landmarks:
    """In target axes; the surface at a landmark is taken as parallel to the target's plane."""
    T_target_ref, normal = inverse_pose(T_ref_target), T_ref_target[:3, 2]
    height = points_cam @ normal
    support = []
    for offset in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        rays = undistort_to_rays(camera, left_px + offset)
        rays = np.column_stack([rays, np.ones(len(rays))])
        support.append(transform_points(T_target_ref, rays * (height / (rays @ normal))[:, None]))
    R = T_target_ref[:3, :3]
    return Landmarks(
        left_px=left_px,
        right_px=right_px,
        points_target=transform_points(T_target_ref, points_cam),
        covariances_target=R @ covariances @ R.T,
        support_target=np.stack(support, axis=1),
    )


def _surface_samples(patch: SurfacePatch, camera: StereoCamera, T_ref_target: Array) -> Landmarks:
    """The patch's own samples as points on its fitted surface."""
    step = max(1, int(np.ceil(len(patch.samples_px) / PATCH_SAMPLES_MAX)))
    left_px, points = patch.samples_px[::step], patch.samples_cam[::step]
    _, right_px = project_stereo(camera, points)
    return landmarks_of(camera, T_ref_target, left_px, right_px, points, np.zeros((len(points), 3, 3)))


def _in_target_axes(patch: SurfacePatch) -> Array:
    """Covariance (6, 6) of the anchored pose in target axes."""
    if patch.T_cam_target is None or patch.covariance is None:
        raise ValueError("the patch was refused; anchor measured patches only")
    R = np.kron(np.eye(2), patch.T_cam_target[:3, :3].T)
    return R @ patch.covariance @ R.T
