"""Boreholes and painted rings of known diameter in one pair: each a patch that can be anchored, numbered."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine.camera import project
from machine.description import StereoCamera
from machine.rotations import rotation_from_rotvec
from server.targets.circle_fit import Circle, CircleFit, fit_circle
from server.targets.circle_search import CirclePlace, find_places
from server.targets.contracts import SurfacePatch, TargetSettings
from server.targets.stereo_match import noise_grey
from server.targets.surface import ROLL_SIGMA_RAD, measure_surface_around, target_frame
from server.vision.contracts import Array, Image
from server.vision.odometry_features import allowed_masks

LOG10_NFA_MAX = -2.0  # one chance circle in a hundred pictures
# Of a rim with an edge within half a pixel: a chip of rock is round by and large, never so exactly
RIM_EDGE_MIN_FRAC = 0.5
# One sigma of a true diameter about the nominal one: wear of a bit, a stencil, shade at the rim
DIAMETER_SIGMA_FRAC = 0.02
CONCENTRIC_OFFSET_MAX_FRAC = 0.4  # of the larger radius: nearer centres belong to one mark
EXCLUDED_DISC_RADIUS_FRAC = 1.25  # of the radius: chips and dust end there, the rock around begins
CHI2_3DOF_999 = 16.3
EDGE_SIGMA_FLOOR_PX = 0.05  # of one edge point; larger where the residuals say so


@dataclass(frozen=True, slots=True)
class RoundMark:
    """One mark. patch: pose (z out of the rock along the rim's axis) and covariance as every target's, measured samples
    around the rim; or refused. diameter_m as measured, with its standard deviation; nominal_m: which of the given ones.
    """

    number: int
    patch: SurfacePatch
    diameter_m: float
    sigma_diameter_m: float
    nominal_m: float
    dark_inside: bool


@dataclass(frozen=True, slots=True)
class RoundMarks:
    """Marks from left to right; reason: why nothing could be searched, empty otherwise."""

    marks: tuple[RoundMark, ...]
    reason: str


def find_round_marks(
    left: Image,
    right: Image,
    camera: StereoCamera,
    diameters_m: Sequence[float],
    settings: TargetSettings,
    masks_px: tuple[Sequence[Array], Sequence[Array]] = ((), ()),
) -> RoundMarks:
    """Every circle of one of the diameters whose rim both eyes see.

    Model:   candidates by votes of edges, a circle in space fitted to both eyes' edges; kept where chance would align
             its edges so well once in a hundred pictures, at least half of the rim lies on an edge, and the diameter is
             a given one. Axis and depth combine the rim's with those of the surface around it, by their information.
    Args:    left, right: raw grey pair (h, w). diameters_m: nominal outer diameters [m]. masks_px: polygons (k, 2) [px]
             of own structure in both images.
    """
    masks = allowed_masks((camera.height_px, camera.width_px), masks_px)
    places = find_places(left, right, camera, diameters_m, settings, masks)
    if isinstance(places, str):
        return RoundMarks((), places)
    fits = _one_of_each(_fit_accepted_circles(left, right, camera, places, diameters_m))
    avoid = [_disc_px(camera, fit) for fit, _, _ in fits]
    marks = []
    for number, (fit, nominal_m, dark_inside) in enumerate(fits, 1):
        patch = _mark_surface_patch(left, right, camera, fit, avoid, settings)
        sigma_m = 2.0 * float(np.sqrt(fit.covariance[6, 6]))
        marks.append(RoundMark(number, patch, 2.0 * fit.circle.radius_m, sigma_m, nominal_m, dark_inside))
    return RoundMarks(tuple(marks), "")


Fitted = tuple[CircleFit, float, bool]  # with the nominal diameter, and whether it is dark inside


def _fit_accepted_circles(
    left: Image, right: Image, camera: StereoCamera, places: Sequence[CirclePlace], diameters_m: Sequence[float]
) -> list[Fitted]:
    noise = max(noise_grey(left), noise_grey(right))
    kept: list[Fitted] = []
    for place in places:
        if any(place.dark_inside == dark and _is_concentric(place.circle, fit.circle) for fit, _, dark in kept):
            continue  # the better voted one has the same rim
        fit = fit_circle(left, right, camera, place.circle, place.dark_inside, EDGE_SIGMA_FLOOR_PX, noise)
        if fit is None or fit.log10_nfa > LOG10_NFA_MAX or fit.rim_frac < RIM_EDGE_MIN_FRAC:
            continue
        diameter_m, sigma_m = 2.0 * fit.circle.radius_m, 2.0 * float(np.sqrt(fit.covariance[6, 6]))
        nominal_m = min(diameters_m, key=lambda one: abs(one - diameter_m))
        if abs(diameter_m - nominal_m) <= 3.0 * float(np.hypot(sigma_m, DIAMETER_SIGMA_FRAC * nominal_m)):
            kept.append((fit, nominal_m, place.dark_inside))
    return kept


def _one_of_each(fits: Sequence[Fitted]) -> list[Fitted]:
    """Of concentric circles one: the outer where they differ in size (a ring's two edges), else the better aligned."""
    kept: list[Fitted] = []
    for fit in sorted(fits, key=lambda one: one[0].log10_nfa):
        rivals = [rival for rival in kept if _is_concentric(fit[0].circle, rival[0].circle)]
        if not rivals:
            kept.append(fit)
        elif all(fit[2] != dark and fit[0].circle.radius_m > 1.05 * rival.circle.radius_m for rival, _, dark in rivals):
            kept = [other for other in kept if not any(other is rival for rival in rivals)] + [fit]
    return sorted(kept, key=lambda one: float(one[0].circle.centre[0] / one[0].circle.centre[2]))


def _is_concentric(first: Circle, second: Circle) -> bool:
    larger = max(first.radius_m, second.radius_m)
    return float(np.linalg.norm(first.centre - second.centre)) < CONCENTRIC_OFFSET_MAX_FRAC * larger


def _disc_px(camera: StereoCamera, fit: CircleFit) -> tuple[float, float, float]:
    u, v = project(camera, fit.circle.centre[None])[0]
    return (
        float(u),
        float(v),
        EXCLUDED_DISC_RADIUS_FRAC * fit.circle.radius_m * camera.fx_px / float(fit.circle.centre[2]),
    )


def _mark_surface_patch(
    left: Image,
    right: Image,
    camera: StereoCamera,
    fit: CircleFit,
    avoid: Sequence[tuple[float, float, float]],
    settings: TargetSettings,
) -> SurfacePatch:
    """The mark as a patch: the rim's circle, axis and depth combined with the surface around it."""
    u, v, _ = _disc_px(camera, fit)
    around = measure_surface_around(left, right, camera, (u, v), float(fit.circle.centre[2]), avoid, settings)
    if around.T_cam_target is None or around.covariance is None:
        return around
    order = [3, 4, 5, 0, 1, 2]  # rotation first
    rough_m = around.residual_px * float(fit.circle.centre[2]) ** 2 / (camera.fx_px * camera.baseline_m)
    axis, centre, C = on_surface(fit.circle, fit.covariance[np.ix_(order, order)], around, rough_m)
    C[:3, :3] += ROLL_SIGMA_RAD**2 * np.eye(3)
    T = target_frame(axis, centre)
    return replace(around, T_cam_target=T, covariance=0.5 * (C + C.T), radius_m=fit.circle.radius_m)


def on_surface(circle: Circle, C: Array, around: SurfacePatch, rough_m: float) -> tuple[Array, Array, Array]:
    """Axis, centre and covariance (6, 6) of a rim after the surface around it is taken in as a second measurement.

    Model:   Kalman update of (rotation, centre) by the surface's normal in the two directions across the axis, and by
             its height at the centre, which the surface's roughness `rough_m` makes uncertain. Where both contradict
             each other at 99.9 %, the rim alone counts.
    """
    if around.T_cam_target is None or around.covariance is None:
        raise ValueError("the surface around the rim was refused")
    axis, normal = circle.axis, around.T_cam_target[:3, 2]
    across = np.linalg.svd(axis[None])[2][1:]
    H = np.zeros((3, 6))
    H[:2, :3], H[2, 3:] = across, normal
    seen = np.append(across @ np.cross(axis, normal), normal @ (around.T_cam_target[:3, 3] - circle.centre))
    S = H @ (C + around.covariance) @ H.T
    S[2, 2] += rough_m**2
    if float(seen @ np.linalg.solve(S, seen)) > CHI2_3DOF_999:
        return axis, circle.centre, C
    K = np.linalg.solve(S, H @ C).T
    step = K @ seen
    return rotation_from_rotvec(step[:3]) @ axis, circle.centre + step[3:], C - K @ H @ C
