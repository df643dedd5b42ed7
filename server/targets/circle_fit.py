"""A circle in space fitted to its edge in both eyes: centre, axis and radius with covariance."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from machine.camera import project, projection_jacobian
from machine.description import StereoCamera
from machine.rotations import rotation_from_rotvec
from server.targets.contracts import BoolArray
from server.vision.contracts import Array, Image
from server.vision.object_pose import fitted_variance

EDGE_POINT_SPACING_PX = 2.0  # of edge points: the point spread correlates nearer ones
ROUNDNESS_SIGMA_FRAC = 0.01  # of the radius: departure of a rim from a circle, one sigma of each low harmonic
PAINTED_EDGE_SIGMA_PX = 0.05  # displacement of a painted edge, one sigma: both its sides lie on the surface
HOLE_EDGE_SIGMA_PX = 0.2  # of a hole's edge: each eye sees another side of the hole, lit or dark, behind it
N = 19  # unknowns: centre, rotation, radius, and first and second harmonics of the rim, left shading, right shading
SEARCH_HALF_WIDTHS_PX = (
    6.0,
    4.0,
    3.0,
    3.0,
    3.0,
    3.0,
)  # of the search along the normals, narrower as the circle settles
PROFILE_STEP_PX = 0.5
PROFILE_SMOOTHING_SIGMA_PX = 1.0  # Gaussian along the profile, before its derivative
EDGE_CONTRAST_MIN_SIGMAS = 4.0  # of an edge's contrast over the image's noise
TUKEY_SIGMAS = 4.685
RIM_DISTANCE_MAX_PX = 0.5  # an edge this near lies on the rim: ten times the noise of one edge point
GRADIENT_ALIGNED_MAX_RAD = np.deg2rad(
    22.5
)  # a gradient this near to the normal counts as aligned; chance gives 45 of 360 deg
CHANCE_ALIGNMENT_PROBABILITY = 2.0 * float(GRADIENT_ALIGNED_MAX_RAD) / (2.0 * np.pi)


@dataclass(frozen=True, slots=True)
class Circle:
    """centre (3,) [m], unit axis (3,) towards the camera, radius [m], all in the left camera's axes."""

    centre: Array
    axis: Array
    radius_m: float

    def points(self, n: int) -> tuple[Array, Array, Array]:
        """n points (n, 3), and their outward and tangential unit vectors (n, 3)."""
        x = np.cross([0.0, 1.0, 0.0], self.axis)
        x /= np.linalg.norm(x)
        y = np.cross(self.axis, x)
        angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)[:, None]
        outward, tangent = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        return self.centre + self.radius_m * outward, outward, tangent


@dataclass(frozen=True, slots=True)
class CircleFit:
    """circle; covariance (7, 7): centre [m], rotation vector [rad], radius [m]; its turn about the axis is free.

    log10_nfa: expected number of chance circles that are as well aligned. rim_frac: share of the rim with an aligned
    edge within half a pixel. Of both the poorer eye's. residual_px: rms.
    """

    circle: Circle
    covariance: Array
    log10_nfa: float
    rim_frac: float
    residual_px: float


@dataclass(frozen=True, slots=True)
class _RimEdges:
    """Distances (n,) [px] of the found edge outside the predicted rim, their Jacobian (n, 19), found or not (n,)."""

    distance_px: Array
    J: Array
    found: BoolArray
    aligned: BoolArray


def fit_circle(
    left: Image,
    right: Image,
    camera: StereoCamera,
    start: Circle,
    dark_inside: bool,
    sigma_px: float,
    noise_grey: float,
) -> CircleFit | None:
    """The circle whose projections lie on the edges in both raw images; None where too little of the rim is seen.

    Model:   residual = distance of the strongest edge of the right sign from the projected rim along its normal, in
             both eyes. The visible rim is a circle with small first and second harmonics: shared ones by chips, and
             each eye's own by the shade inside, must pass neither for a tilt nor for a depth. Gauss-Newton with
             Tukey's biweight, scale from the median. Covariance from the assumed noise `sigma_px`, or from the
             residuals where they refute it; neighbours' correlation counted.
    Returns: CircleFit, see there; the rim's chance alignment is judged as in a-contrario detection.
    Source:  Harris and Stennett 1990 (RAPID); Desolneux, Moisan and Morel 2000 (number of false alarms).
    """
    circle, sign = start, 1.0 if dark_inside else -1.0
    images = (left.astype(np.float32), right.astype(np.float32))
    sigma_edge_m = (
        (HOLE_EDGE_SIGMA_PX if dark_inside else PAINTED_EDGE_SIGMA_PX) * float(start.centre[2]) / camera.fx_px
    )
    eyes: list[_RimEdges] = []
    weights, J, residual = np.zeros(0), np.zeros((0, N)), np.zeros(0)
    step, harmonics, scale = np.zeros(N), np.zeros(N - 7), sigma_px
    for reach in SEARCH_HALF_WIDTHS_PX:
        eyes = [
            _find_rim_edges(image, camera, circle, harmonics, k, sign, reach, noise_grey)
            for k, image in enumerate(images)
        ]
        if min(eye.found.sum() for eye in eyes) < 12:
            return None
        J = np.vstack([eye.J[eye.found] for eye in eyes])
        residual = np.concatenate([eye.distance_px[eye.found] for eye in eyes])
        scale = max(1.4826 * float(np.median(np.abs(residual))), sigma_px)
        prior, towards = _prior_information(circle, sigma_edge_m), np.concatenate([np.zeros(7), harmonics])
        step = np.zeros(N)
        for _ in range(3):
            weights = np.clip(1.0 - ((residual - J @ step) / (TUKEY_SIGMAS * scale)) ** 2, 0.0, None) ** 2
            A = J * weights[:, None]
            information = A.T @ J / scale**2 + prior
            gradient = A.T @ residual / scale**2 - prior @ towards
            step = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        circle, harmonics = _stepped_circle(circle, step), harmonics + step[7:]
        if not 0.5 < circle.radius_m / start.radius_m < 2.0 or circle.centre[2] < 0.1:
            return None
    on = weights > 0.05
    residual = residual - J @ step
    n_left = int(eyes[0].found.sum())
    longer = _correlation_factor([residual[:n_left][on[:n_left]], residual[n_left:][on[n_left:]]])
    dof = max(int(on.sum() / longer) - 6, 1)
    variance = fitted_variance(float(np.sum(residual[on] ** 2)) / longer, dof, sigma_px) * longer
    covariance = np.linalg.inv(J[on].T @ J[on] / variance + _prior_information(circle, sigma_edge_m))[:7, :7]
    covariance[6, 6] += sigma_edge_m**2  # all around: a smaller hole
    return CircleFit(
        circle,
        0.5 * (covariance + covariance.T),
        max(_log10_nfa(eye.aligned, camera) for eye in eyes),
        min(float(np.mean(eye.aligned & eye.found & (np.abs(eye.distance_px) < RIM_DISTANCE_MAX_PX))) for eye in eyes),
        float(np.sqrt(np.mean(residual[on] ** 2))),
    )


AXIS_TURN_SIGMA_RAD = 1e-4  # the turn about the axis is a convention; no covariance may be singular


def _prior_information(circle: Circle, sigma_edge_m: float) -> Array:
    """Information (19, 19) on the turn about the axis, which nothing else determines, and on the rim's harmonics."""
    out = np.zeros((N, N))
    out[3:6, 3:6] = np.outer(circle.axis, circle.axis) / AXIS_TURN_SIGMA_RAD**2
    out[7:11, 7:11] = np.eye(4) / (ROUNDNESS_SIGMA_FRAC * circle.radius_m) ** 2
    out[11:, 11:] = np.eye(N - 11) / sigma_edge_m**2
    return out


def _stepped_circle(circle: Circle, step: Array) -> Circle:
    axis = rotation_from_rotvec(step[3:6]) @ circle.axis
    return Circle(circle.centre + step[:3], axis / np.linalg.norm(axis), circle.radius_m + float(step[6]))


def _find_rim_edges(
    image: NDArray[np.float32],
    camera: StereoCamera,
    circle: Circle,
    harmonics: Array,
    eye: int,
    sign: float,
    reach: float,
    noise_grey: float,
) -> _RimEdges:
    """Edges along the normals of the rim in one eye (0 left, 1 right)."""
    shift = np.array([eye * camera.baseline_m, 0.0, 0.0])
    around = 2.0 * np.pi * circle.radius_m * camera.fx_px / float(circle.centre[2])
    n = max(24, int(around / EDGE_POINT_SPACING_PX))
    points, outward, tangent = circle.points(n)
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    waves = np.column_stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)])
    none = np.zeros_like(waves)
    waves = np.hstack([waves, none, waves] if eye else [waves, waves, none])
    points = points + (waves @ harmonics)[:, None] * outward
    with np.errstate(invalid="ignore"):
        pixels = project(camera, points - shift)
    J_point = projection_jacobian(camera, points - shift)
    along = np.einsum("nij,nj->ni", J_point, tangent)
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.sign(np.einsum("ni,nij,nj->n", normal, J_point, outward))[:, None]
    offsets = np.arange(-reach - 3.0, reach + 3.0 + 1e-9, PROFILE_STEP_PX)
    inside = np.asarray(np.isfinite(pixels).all(axis=1))
    border = reach + 4.0
    inside &= (pixels > border).all(axis=1) & (pixels < [image.shape[1] - border, image.shape[0] - border]).all(axis=1)
    where = np.where(inside[:, None], pixels, border)
    profile = _sample_bilinear(image, where[:, None, :] + offsets[None, :, None] * normal[:, None, :])
    slope = cv2.GaussianBlur(profile, (0, 0), sigmaX=PROFILE_SMOOTHING_SIGMA_PX / PROFILE_STEP_PX, sigmaY=1e-3)
    slope = sign * np.gradient(np.asarray(slope, dtype=np.float64), PROFILE_STEP_PX, axis=1)
    searched = slope.copy()
    searched[:, np.abs(offsets) > reach] = -np.inf
    at = searched.argmax(axis=1)
    rows = np.arange(n)
    peak, before, after = slope[rows, at], slope[rows, at - 1], slope[rows, at + 1]
    bend = before - 2.0 * peak + after
    sub = np.where(bend < -1e-9, 0.5 * (before - after) / np.where(bend < -1e-9, bend, -1.0), 0.0)
    distance = offsets[at] + np.clip(sub, -1.0, 1.0) * PROFILE_STEP_PX
    # a profile's slope of white noise n has n / (2 sqrt(2) pi^(1/4) s^(3/2)) where its samples are one pixel apart
    slope_noise = noise_grey / (2.0 * np.sqrt(2.0) * np.pi**0.25 * PROFILE_SMOOTHING_SIGMA_PX**1.5)
    found = inside & (peak > EDGE_CONTRAST_MIN_SIGMAS * slope_noise) & (peak > before) & (peak >= after)
    lever = np.cross(points - circle.centre, np.einsum("ni,nij->nj", normal, J_point))
    growth = np.einsum("ni,nij,nj->n", normal, J_point, outward)[:, None]
    J = np.asarray(
        np.hstack([np.einsum("ni,nij->nj", normal, J_point), lever, growth, growth * waves]), dtype=np.float64
    )
    return _RimEdges(distance, J, found, inside & _is_gradient_along_normal(image, where, normal, sign))


def _sample_bilinear(image: NDArray[np.float32], places: Array) -> np.ndarray:
    maps = places.astype(np.float32)
    return np.asarray(cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR))


def _is_gradient_along_normal(image: NDArray[np.float32], pixels: Array, normal: Array, sign: float) -> BoolArray:
    """Whether the image's gradient at the rim (Gaussian of 1 px) points along the normal."""
    across = np.column_stack([-normal[:, 1], normal[:, 0]])
    steps = np.array([1.0, -1.0])
    radial = _sample_bilinear(image, pixels[:, None] + steps[None, :, None] * normal[:, None])
    sideways = _sample_bilinear(image, pixels[:, None] + steps[None, :, None] * across[:, None])
    g_n = sign * (radial[:, 0] - radial[:, 1])
    g_t = sideways[:, 0] - sideways[:, 1]
    return np.asarray(np.abs(np.arctan2(g_t, g_n)) < GRADIENT_ALIGNED_MAX_RAD)


def _log10_nfa(aligned: BoolArray, camera: StereoCamera) -> float:
    """log10 of the expected number of ellipses in a picture of noise that are as well aligned.

    Source:  (w h)^(5/2) ellipses are tried: Patraucean, Gurdjos and von Gioi 2012.
    """
    n, k = len(aligned), int(aligned.sum())
    tests = 2.5 * np.log10(float(camera.width_px * camera.height_px))
    by_chance = float(bdtrc(k - 1, n, CHANCE_ALIGNMENT_PROBABILITY))
    return float(tests + np.log10(max(by_chance, np.finfo(float).tiny)))


def _correlation_factor(series: list[Array]) -> float:
    """How many neighbouring residuals amount to one independent one: 1 + 2 sum of the autocorrelation until it is 0."""
    factors = []
    for values in series:
        r = values - values.mean()
        power = float(r @ r)
        total = 1.0
        for lag in range(1, len(r) // 4):
            rho = float(r @ np.roll(r, lag)) / max(power, 1e-12)
            if rho <= 0.0:
                break
            total += 2.0 * rho
        factors.append(total)
    return float(max(np.mean(factors), 1.0))
