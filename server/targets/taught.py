"""Taught objects: landmarks of a few stereo views in the object's frame, which a marker in the picture gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import project, project_stereo, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array, rotation_from_rotvec, rotvec_from_rotation, skew
from server.targets.anchor import LANDMARKS_MIN, landmarks_of
from server.targets.contracts import AnchoredTarget, BoolArray, Landmarks, TargetSettings
from server.targets.tracking import FIX_LANDMARKS_MIN, MarksPose, SearchedPair, align_marks, solve_pose
from server.vision.contracts import Image
from server.vision.odometry_align import align_reference_patches
from server.vision.odometry_features import allowed_masks, inside_mask
from server.vision.odometry_keyframe import triangulated
from server.vision.odometry_sight import StereoMatches, optical_flow, plausible_match_mask

SIFT_CONTRAST_MIN = 0.02  # half of OpenCV's default: worn paint has less contrast than the rock around it
DESCRIPTOR_MARGIN_PX = 32  # about the features' region: the support of a descriptor
SPREAD_PX, PER_SPREAD = 32, 8  # features of a whole image: no more in a cell, about 7000 at 720p
# A landmark that only one view shows may be a shadow, a highlight or an edge before the background
TAUGHT_VIEWS_MIN = 2
LANDMARK_CELL_PX = 11  # one landmark a cell: an object is small, so patches of 15 px may overlap by a quarter

Descriptors = NDArray[np.uint8]
Polygons = tuple[tuple[Array, ...], tuple[Array, ...]]


@dataclass(frozen=True, slots=True)
class ObjectBox:
    """Where the object is in the axes of the marker it is taught with: its middle and its full size (3,) [m].

    The object's frame is the marker's, moved to `centre_m`.
    """

    centre_m: Array
    size_m: Array

    @property
    def corners(self) -> Array:
        """Its eight corners (8, 3) in object axes."""
        signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        return signs * self.size_m


@dataclass(frozen=True, slots=True)
class TaughtView:
    """One raw pair (h, w) with the object, its landmarks in object axes and their descriptors (n, 128).

    T_cam_object (4, 4) and covariance (6, 6), as ObjectPose: of the object's frame by the marker; in a taught object
    T_cam_object is as all views together place it. masks_px: the own tool and the markers.
    """

    reference_left: Image
    reference_right: Image
    T_cam_object: Array
    covariance: Array
    landmarks: Landmarks
    descriptors: Descriptors
    masks_px: Polygons

    @property
    def reference_images(self) -> tuple[Image, Image]:
        """Both eyes' images."""
        return self.reference_left, self.reference_right


@dataclass(frozen=True, slots=True)
class TaughtObject:
    """An object that can be recognised without its marker.

    covariance_target (6, 6): of its frame against the marker's, object axes. sigma_scale_frac: as AnchoredTarget.
    agree_frac: the least share of one view's visible landmarks that another view confirmed.
    """

    name: str
    size_m: Array
    views: tuple[TaughtView, ...]
    covariance_target: Array
    sigma_scale_frac: float
    agree_frac: float


def image_features(image: Image, mask: Image) -> tuple[Array, Descriptors]:
    """Places (n, 2) [px], strongest first, and descriptors (n, 128), spread evenly: rock must not outnumber all else.

    Source:  Lowe 2004 (SIFT).
    """
    sift = cv2.SIFT.create(contrastThreshold=SIFT_CONTRAST_MIN)
    u, v, width, height = cv2.boundingRect(mask)
    left, top = max(u - DESCRIPTOR_MARGIN_PX, 0), max(v - DESCRIPTOR_MARGIN_PX, 0)
    part = np.s_[top : v + height + DESCRIPTOR_MARGIN_PX, left : u + width + DESCRIPTOR_MARGIN_PX]
    points = sorted(sift.detect(image[part], mask[part]), key=lambda point: -point.response) if width else []
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 128), np.uint8)
    chosen = _strongest_by_cell(np.array([point.pt for point in points]), SPREAD_PX, PER_SPREAD)
    points, found = sift.compute(image[part], [points[k] for k in chosen])
    places = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2) + np.array([left, top])
    return places, np.clip(np.rint(found), 0, 255).astype(np.uint8)


def teach_view(
    left: Image,
    right: Image,
    camera: StereoCamera,
    T_cam_marker: Array,
    covariance: Array,
    box: ObjectBox,
    masks_px: tuple[Sequence[Array], Sequence[Array]],
    settings: TargetSettings,
) -> TaughtView | str:
    """The landmarks of one view, or why it cannot be used.

    Model:   SIFT features inside the projected box, the strongest of each cell; matched in the right eye by flow and
             sub-pixel alignment; triangulated; those outside the box are dropped.
    Args:    T_cam_marker (4, 4), covariance (6, 6): as ObjectPose. masks_px: polygons (k, 2) [px] in the left and the
             right image that are no part of the object: the own tool, the markers.
    """
    T_cam_object = T_cam_marker @ pose(np.eye(3), box.centre_m)
    polygons = tuple(masks_px[0]), tuple(masks_px[1])
    size = (camera.height_px, camera.width_px)
    both = allowed_masks(size, polygons)
    inside = _box_mask(camera, T_cam_object, box, size)
    places, descriptors = image_features(left, np.asarray(np.minimum(both[0], inside)))
    first = _strongest_by_cell(places, LANDMARK_CELL_PX, 1)
    left_px, descriptors = places[first], descriptors[first]
    right_px, good = _in_right(left, right, camera, left_px, float(T_cam_object[2, 3]))
    good &= inside_mask(both[1], right_px)
    left_px, right_px, descriptors = left_px[good], right_px[good], descriptors[good]
    points, covariances = triangulated(camera, StereoMatches(left_px, right_px), settings.sigma_px)
    near = np.all(np.abs(transform_points(inverse_pose(T_cam_object), points)) <= 0.5 * box.size_m, axis=1)
    if near.sum() < LANDMARKS_MIN:
        return (
            f"{near.sum()} features of the object are seen in both eyes (limit {LANDMARKS_MIN}); come nearer, add "
            "light, or correct the object's place and size against the marker"
        )
    marks = landmarks_of(camera, T_cam_object, left_px[near], right_px[near], points[near], covariances[near])
    carried = _frame_covariance(covariance, T_cam_marker, box)
    return TaughtView(left.copy(), right.copy(), T_cam_object, carried, marks, descriptors[near], polygons)


def _box_mask(camera: StereoCamera, T_cam_object: Array, box: ObjectBox, size: tuple[int, int]) -> Image:
    """255 inside the outline of the projected box."""
    mask = np.zeros(size, np.uint8)
    corners = transform_points(T_cam_object, box.corners)
    if np.all(corners[:, 2] > 0.05):
        outline = cv2.convexHull(np.round(project(camera, corners)).astype(np.int32))
        cv2.fillConvexPoly(mask, outline, 255)
    return mask


def _strongest_by_cell(places: Array, cell_px: float, most: int) -> NDArray[np.int64]:
    """Indices of the first places in every cell, `most` each."""
    cells = np.floor(places / cell_px).astype(np.int64)
    _, number, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(number.ravel(), kind="stable")
    rank = np.empty(len(places), dtype=np.int64)
    rank[order] = np.arange(len(places)) - np.repeat(np.cumsum(count) - count, count)
    return np.flatnonzero(rank < most)


def _in_right(
    left: Image, right: Image, camera: StereoCamera, left_px: Array, depth_m: float
) -> tuple[Array, BoolArray]:
    """Right pixels (n, 2) of left places, guessed at the object's depth, and which are good."""
    if not len(left_px):
        return left_px, np.zeros(0, dtype=bool)
    guess = left_px - [camera.fx_px * camera.baseline_m / depth_m, 0.0]
    coarse = optical_flow(left, right, left_px, guess)
    fine = align_reference_patches(left, left_px, np.tile(np.eye(2), (len(left_px), 1, 1)), right, coarse.points_px)
    good = coarse.valid & fine.valid
    return fine.points_px, plausible_match_mask(camera, undistort_to_rays(camera, left_px), fine.points_px, good)


def _frame_covariance(covariance: Array, T_cam_marker: Array, box: ObjectBox) -> Array:
    """Covariance (6, 6) of the object's frame, moved from the marker by a lever arm."""
    J = np.eye(6)
    J[3:, :3] = -skew(T_cam_marker[:3, :3] @ box.centre_m)
    return J @ covariance @ J.T


def teach_object(
    name: str, views: Sequence[TaughtView], box: ObjectBox, camera: StereoCamera, settings: TargetSettings
) -> TaughtObject | str:
    """The object of all views, or why they do not belong together.

    Model:   the view with the most landmarks gives the frame; every other view is placed in it by those landmarks, in
             both eyes; a landmark is kept where another view confirms it. The frame is then moved to the mean of all
             markers' frames.
    """
    if len(views) < TAUGHT_VIEWS_MIN:
        return (
            f"{len(views)} views of '{name}' (limit {TAUGHT_VIEWS_MIN}); add one from another side, 10 to 30 deg away"
        )
    first = int(np.argmax([len(view.landmarks) for view in views]))
    placed: list[TaughtView] = []
    for number, view in enumerate(views):
        found = _seen_in(views[first], view, camera, settings)
        if found is None:
            return (
                f"view {number + 1} of '{name}' does not show the landmarks of view {first + 1}; the object or the "
                "marker has moved between them, or they are too far apart: take them again"
            )
        placed.append(
            view
            if number == first
            else replace(view, landmarks=_landmarks_at_pose(view, found.T_cam_target), T_cam_object=found.T_cam_target)
        )
    confirmed, shares = _confirm_landmarks(placed, camera, settings)
    some = [view for view in confirmed if len(view.landmarks) >= FIX_LANDMARKS_MIN]
    total = sum(len(view.landmarks) for view in some)
    if total < LANDMARKS_MIN:
        return (
            f"{total} landmarks of '{name}' are confirmed by a second view (limit {LANDMARKS_MIN}); take views that "
            "overlap more, or of a side with more texture"
        )
    shift, covariance = _frame_shift(views, placed)
    covariance += _turn_covariance(box, settings)
    final = tuple(_view_in_new_frame(view, shift) for view in some)
    depth = float(np.mean([view.T_cam_object[2, 3] for view in final]))
    scale = depth * settings.sigma_disparity_px / (camera.fx_px * camera.baseline_m)
    return TaughtObject(name, box.size_m.copy(), final, covariance, scale, min(shares))


def _seen_in(view: TaughtView, other: TaughtView, camera: StereoCamera, settings: TargetSettings) -> MarksPose | None:
    """Where one view's landmarks place the object in another view; None where they are not found."""
    pair = _as_pair(other, camera, settings)
    seen, _ = align_marks(view.reference_images, view.landmarks, pair, other.T_cam_object)
    if len(seen.indices) < FIX_LANDMARKS_MIN:
        return None
    fit = solve_pose(pair, view.landmarks, seen, other.T_cam_object)
    return fit if fit.inliers.sum() >= FIX_LANDMARKS_MIN else None


def _as_pair(view: TaughtView, camera: StereoCamera, settings: TargetSettings) -> SearchedPair:
    masks = allowed_masks((camera.height_px, camera.width_px), view.masks_px)
    return SearchedPair(view.reference_images, masks, camera, settings)


def _landmarks_at_pose(view: TaughtView, T_cam_object: Array) -> Landmarks:
    """The view's landmarks in the object axes that stand at T_cam_object in its camera."""
    return _in_axes(view.landmarks, inverse_pose(T_cam_object) @ view.T_cam_object)


def _in_axes(marks: Landmarks, T_new_old: Array) -> Landmarks:
    R = T_new_old[:3, :3]
    support = transform_points(T_new_old, marks.support_target.reshape(-1, 3)).reshape(marks.support_target.shape)
    return replace(
        marks,
        points_target=transform_points(T_new_old, marks.points_target),
        covariances_target=R @ marks.covariances_target @ R.T,
        support_target=support,
    )


def _confirm_landmarks(
    views: Sequence[TaughtView], camera: StereoCamera, settings: TargetSettings
) -> tuple[list[TaughtView], list[float]]:
    """The views with those landmarks that another one confirms, and the best share of each view that one confirmed."""
    kept, shares = [], []
    for view in views:
        agreed = np.zeros(len(view.landmarks), dtype=bool)
        best = 0.0
        for other in views:
            if other is view:
                continue
            pair = _as_pair(other, camera, settings)
            seen, visible = align_marks(view.reference_images, view.landmarks, pair, other.T_cam_object)
            if len(seen.indices) < FIX_LANDMARKS_MIN:
                continue
            fit = solve_pose(pair, view.landmarks, seen, other.T_cam_object)
            agreed[seen.indices[fit.inliers]] = True
            best = max(best, float(fit.inliers.sum()) / visible)
        kept.append(replace(view, landmarks=view.landmarks.subset(agreed), descriptors=view.descriptors[agreed]))
        shares.append(best)
    return kept, shares


def _frame_shift(views: Sequence[TaughtView], placed: Sequence[TaughtView]) -> tuple[Array, Array]:
    """T_frame_mean (4, 4): the mean of the markers' frames in the placed frame, and its covariance (6, 6) there.

    Model:   weighted mean of the small twists between the two, each with its marker's covariance.
    """
    information, right_side = np.zeros((6, 6)), np.zeros(6)
    for view, at in zip(views, placed, strict=True):
        T = inverse_pose(at.T_cam_object) @ view.T_cam_object
        twist = np.concatenate([rotvec_from_rotation(T[:3, :3]), T[:3, 3]])
        R = np.kron(np.eye(2), at.T_cam_object[:3, :3].T)
        weight = np.linalg.inv(R @ view.covariance @ R.T)
        information += weight
        right_side += weight @ twist
    covariance = np.linalg.inv(information)
    mean = covariance @ right_side
    return pose(rotation_from_rotvec(mean[:3]), mean[3:]), np.asarray(covariance, dtype=np.float64)


def _turn_covariance(box: ObjectBox, settings: TargetSettings) -> Array:
    """Of the object's frame (6, 6): print and mounting turn the markers' frame, in all views alike."""
    J = np.vstack([np.eye(3), -skew(box.centre_m)])
    return settings.sigma_frame_rad**2 * (J @ J.T)


def _view_in_new_frame(view: TaughtView, T_frame_mean: Array) -> TaughtView:
    return replace(
        view,
        T_cam_object=view.T_cam_object @ T_frame_mean,
        landmarks=_in_axes(view.landmarks, inverse_pose(T_frame_mean)),
        masks_px=((), ()),
    )


def outline_px(camera: StereoCamera, T_cam_object: Array, size_m: Array) -> Array:
    """Raw left pixels (4, 2) of the object's face, to be drawn."""
    half = 0.5 * size_m[:2]
    face = np.array(
        [[-half[0], half[1], 0.0], [half[0], half[1], 0.0], [half[0], -half[1], 0.0], [-half[0], -half[1], 0.0]]
    )
    return project_stereo(camera, transform_points(T_cam_object, face))[0]


def anchor_covariance(target: AnchoredTarget | TaughtObject, T_cam_target: Array) -> Array:
    """Covariance (6, 6) of a target's pose in camera axes that all its looks have in common.

    Model:   the first measurement's noise, turned with the target, and the scale of its surroundings: a share of all
             distances, so it shifts the target along its place in the camera.
    """
    R = np.kron(np.eye(2), T_cam_target[:3, :3])
    C = R @ target.covariance_target @ R.T
    place = T_cam_target[:3, 3]
    C[3:, 3:] += target.sigma_scale_frac**2 * np.outer(place, place)
    return C
