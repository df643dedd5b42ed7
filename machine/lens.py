"""Largest angle up to which a lens model with radial terms k1, k2, k3 can be inverted."""

from functools import lru_cache

import numpy as np

Coefficients = tuple[float, float, float, float, float]  # k1, k2, p1, p2, k3


@lru_cache(maxsize=64)
def fold_radius(distortion: Coefficients) -> float:
    """Largest undistorted radius |(x/z, y/z)| that the radial model maps one to one; infinite if it never folds back.

    Model: r' = r (1 + k1 r^2 + k2 r^4 + k3 r^6) turns where 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6 = 0.
    """
    k1, k2, _, _, k3 = distortion
    roots = np.roots(np.trim_zeros([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0], "f"))
    turning = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
    return float(np.sqrt(turning.min())) if turning.size else float("inf")


def distorted_radius_max(distortion: Coefficients) -> float:
    """Largest distorted radius that some ray has: the image must lie inside it. Infinite if the model never folds."""
    radius = fold_radius(distortion)
    if np.isinf(radius):
        return radius
    k1, k2, _, _, k3 = distortion
    r2 = radius * radius
    return radius * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))


#: Of the image's width or height. Lens and sensor are centred to 1 or 2 %, a rectified picture to about 5 %; beyond
#: 10 % the picture was cropped, or the calibration is of another image size.
PRINCIPAL_OFFSET_MAX_FRAC = 0.1


def principal_off_frac(principal_px: tuple[float, float], size_px: tuple[int, int]) -> float:
    """How far the principal point lies from the image's middle, as a share of its width or height: the larger one."""
    return max(abs(at - 0.5 * (side - 1.0)) / side for at, side in zip(principal_px, size_px, strict=True))
