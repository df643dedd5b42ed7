"""Where circles of known diameter may be: the wall seen squarely, and its edges' votes for centres."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from machine.camera import project, undistort_to_rays
from machine.description import StereoCamera
from machine.poses import transform_points
from server.targets.circle_fit import Circle
from server.targets.contracts import TargetSettings
from server.targets.stereo_match import coarse_disparity
from server.targets.surface import target_frame
from server.vision.contracts import Array, Image
from server.vision.odometry_keyframe import triangulated
from server.vision.odometry_sight import ImageSight

CORNERS_MAX = 1500
RANSAC_ITERATIONS = 200
PLANE_POINTS_MIN = 50  # corners on it
RADIUS_SPREAD_FRAC = 0.08  # of a radius in the square view: relief of 50 mm at 0.6 m, slopes of 20 deg
RIM_VOTES_MIN_FRAC = 0.3  # of a rim's length that votes: half of it may be lost, and it is thickened by the relief
RADIUS_MIN_PX = 14.0  # of the smallest rim in the square view: its votes then still fall together
CANDIDATES_MAX = 60  # per sign; each is then judged by its fit in both eyes
GRADIENT_BLUR_SIGMA_PX = 1.0
DISPARITY_SLACK_PX = 12.0  # of a mark's disparity about the plane's: 60 mm of relief at 0.6 m


@dataclass(frozen=True, slots=True)
class CirclePlace:
    """A circle to begin a fit with, and whether it is dark inside."""

    circle: Circle
    dark_inside: bool
    cover_frac: float


@dataclass(frozen=True, slots=True)
class SquareView:
    """The wall's mean plane as an image: pixel (column, row) of `grey` lies at `T_cam_plane` @ (x, y, 0)."""

    grey: Image
    valid_mask: Image
    T_cam_plane: Array
    origin_m: Array
    px_m: float

    def points_of(self, pixels: Array) -> Array:
        """Points (n, 3) [m] in the camera of pixels (n, 2)."""
        xy = self.origin_m + pixels * [1.0, -1.0] / self.px_m
        return transform_points(self.T_cam_plane, np.column_stack([xy, np.zeros(len(xy))]))


def find_places(
    left: Image,
    right: Image,
    camera: StereoCamera,
    diameters_m: Sequence[float],
    settings: TargetSettings,
    masks: tuple[Image, Image],
) -> list[CirclePlace] | str:
    """Circles of the given diameters that edges vote for, best first; or why the wall's plane is not known (text).

    Model:   corners in both eyes give the wall's mean plane; the left image is warped onto it, where a circle on the
             rock is nearly a circle of known radius. Every edge votes for centres along its gradient.
    Args:    masks: (h, w) of both eyes, 255 = may be used.
    """
    T = wall_plane(left, right, camera, settings, masks)
    if T is None:
        return (
            f"the wall's plane is not known: fewer than {PLANE_POINTS_MIN} points on one plane in both eyes; add "
            "light, come nearer or face the wall"
        )
    view = square_view(left, camera, T, masks[0], 0.5 * min(diameters_m))
    radii_m = _candidate_radii(diameters_m, 1.0 / view.px_m)
    places = [place for dark_inside in (True, False) for place in _vote_circle_centres(view, radii_m, dark_inside)]
    return [
        CirclePlace(_at_its_depth(left, right, camera, place.circle), place.dark_inside, place.cover_frac)
        for place in sorted(places, key=lambda place: -place.cover_frac)
    ]


def wall_plane(
    left: Image, right: Image, camera: StereoCamera, settings: TargetSettings, masks: tuple[Image, Image]
) -> Array | None:
    """T_cam_plane (4, 4) of the plane that most corners lie on within 3 % of their range; z towards the camera."""
    found = ImageSight(left, right, masks, 0).match_eyes(camera, CORNERS_MAX, np.zeros((0, 2)))
    points = triangulated(camera, found, settings.sigma_px)[0]
    points = points[(points[:, 2] > settings.depth_min_m) & (points[:, 2] < settings.depth_max_m)]
    if len(points) < PLANE_POINTS_MIN:
        return None
    rng = np.random.default_rng(0)
    limit = 0.03 * float(np.median(points[:, 2]))
    best = np.zeros(len(points), dtype=bool)
    for _ in range(RANSAC_ITERATIONS):
        three = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(three[1] - three[0], three[2] - three[0])
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            continue
        on = np.abs((points - three[0]) @ (normal / length)) < limit
        if on.sum() > best.sum():
            best = on
    if best.sum() < PLANE_POINTS_MIN:
        return None
    middle = points[best].mean(axis=0)
    normal = np.linalg.svd(points[best] - middle)[2][2]
    return target_frame(-np.sign(normal @ middle) * normal, middle)


def square_view(left: Image, camera: StereoCamera, T_cam_plane: Array, mask: Image, smallest_m: float) -> SquareView:
    """The left image on the plane; unknown where the eye or the mask ends.

    Its resolution is that of its middle, or less where the smallest radius [m] still has RADIUS_MIN_PX.
    """
    height, width = left.shape
    rim = np.array([[u, v] for u in (0.0, width / 2, width - 1.0) for v in (0.0, height / 2, height - 1.0)])
    rays = undistort_to_rays(camera, rim)
    rays = np.column_stack([rays, np.ones(len(rays))])
    n, p = T_cam_plane[:3, 2], T_cam_plane[:3, 3]
    towards = np.minimum(rays @ n, -0.1)  # rays along the plane end somewhere
    hits = rays * ((p @ n) / towards)[:, None]
    xy = ((hits - p) @ T_cam_plane[:3, :3])[:, :2]
    low, high = xy.min(axis=0), xy.max(axis=0)
    px_m = min(camera.fx_px / float(p[2]), RADIUS_MIN_PX / smallest_m)
    size = np.minimum(np.ceil((high - low) * px_m).astype(int), 2 * np.array([width, height]))
    origin = np.array([low[0], high[1]])
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    view = SquareView(left, mask, T_cam_plane, origin, px_m)
    pixels = project(camera, view.points_of(np.column_stack([u.ravel(), v.ravel()]).astype(float)))
    maps = np.nan_to_num(pixels, nan=-1e4).astype(np.float32).reshape(size[1], size[0], 2)
    grey = cv2.remap(left, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    known = cv2.remap(mask, maps[..., 0], maps[..., 1], cv2.INTER_NEAREST, borderValue=0)
    return SquareView(np.asarray(grey, np.uint8), np.asarray(known, np.uint8), T_cam_plane, origin, px_m)


def _candidate_radii(diameters_m: Sequence[float], px: float) -> Array:
    """Radii [m] within the spread of any diameter, a pixel apart."""
    low, high = 0.5 * (1.0 - RADIUS_SPREAD_FRAC) * min(diameters_m), 0.5 * (1.0 + RADIUS_SPREAD_FRAC) * max(diameters_m)
    all_m = np.arange(low, high + px, px)
    near = [np.abs(all_m / (0.5 * diameter) - 1.0) <= RADIUS_SPREAD_FRAC + px / diameter for diameter in diameters_m]
    return np.asarray(all_m[np.any(near, axis=0)])


def _vote_circle_centres(view: SquareView, radii_m: Array, dark_inside: bool) -> list[CirclePlace]:
    """Centres by the share of the rim that votes for them."""
    smooth = cv2.GaussianBlur(view.grey.astype(np.float32), (0, 0), GRADIENT_BLUR_SIGMA_PX)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    size = np.hypot(gx, gy)
    inner = cv2.erode(view.valid_mask, np.ones((7, 7), np.uint8)) > 0
    if not inner.any():
        return []
    strong = inner & (size > np.median(size[inner])) & _non_maximum_suppression(size, gx, gy)
    v, u = np.nonzero(strong)
    towards = -np.column_stack([gx[v, u], gy[v, u]]) / size[v, u][:, None] * (1.0 if dark_inside else -1.0)
    height, width = view.grey.shape
    best, best_radius = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for r in radii_m * view.px_m:
        x, y = np.rint(u + r * towards[:, 0]).astype(np.int32), np.rint(v + r * towards[:, 1]).astype(np.int32)
        good = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        votes = np.bincount(y[good] * width + x[good], minlength=width * height)
        # a rim's votes spread over about 3 px by the relief and the gradients' noise
        cover = cv2.boxFilter(votes.reshape(height, width).astype(np.float32), -1, (5, 5), normalize=False)
        cover /= np.float32(2.0 * np.pi * r)
        best_radius[cover > best] = r
        np.maximum(best, cover, out=best)
    return _vote_peaks(view, best, best_radius, float(radii_m.min()) * view.px_m, dark_inside)


def _non_maximum_suppression(size: np.ndarray, gx: np.ndarray, gy: np.ndarray) -> np.ndarray:
    """Pixels that are the largest along their gradient's main axis: one vote per length of edge."""
    left, right = np.roll(size, 1, 1), np.roll(size, -1, 1)
    up, down = np.roll(size, 1, 0), np.roll(size, -1, 0)
    across = np.abs(gx) >= np.abs(gy)
    return np.where(across, (size > left) & (size >= right), (size > up) & (size >= down))


def _vote_peaks(
    view: SquareView, cover: np.ndarray, radii: np.ndarray, radius: float, dark_inside: bool
) -> list[CirclePlace]:
    kernel = 2 * int(radius) + 1
    top = cv2.dilate(cover, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (kernel, kernel)))
    v, u = np.nonzero((cover >= top) & (cover > RIM_VOTES_MIN_FRAC))
    order = np.argsort(-cover[v, u])[:CANDIDATES_MAX]
    centres = view.points_of(np.column_stack([u, v]).astype(float)[order])
    axis = view.T_cam_plane[:3, 2]
    return [
        CirclePlace(Circle(centre, axis, float(radii[y, x] / view.px_m)), dark_inside, float(cover[y, x]))
        for centre, x, y in zip(centres, u[order], v[order], strict=True)
    ]


def _at_its_depth(left: Image, right: Image, camera: StereoCamera, circle: Circle) -> Circle:
    """The same circle moved along its ray to where its surroundings match in both eyes."""
    ray = circle.centre[:2] / circle.centre[2]
    expected = camera.fx_px * camera.baseline_m / float(circle.centre[2])
    half = round(1.5 * circle.radius_m * camera.fx_px / float(circle.centre[2]))
    match = coarse_disparity(
        camera, left, right, ray, half, (expected - DISPARITY_SLACK_PX, expected + DISPARITY_SLACK_PX)
    )
    if not np.isfinite(match.disparity_px):
        return circle
    scale = expected / match.disparity_px
    return Circle(circle.centre * scale, circle.axis, circle.radius_m * scale)
