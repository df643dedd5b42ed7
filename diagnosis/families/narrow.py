"""Families of a few numbers each behind the encoders: an error of one joint's angle, a camera's clock, a lens,
the size of a marker.

Why beside the wide ones: a name that stands in for a kindred one takes most of it along, and what it leaves drowns in
thirty numbers where it shows in five. Each holds effects of the catalogue (a zero and a scale are functions of the
angle, too) and whatever else is such a function.
"""

import numpy as np
from numpy.polynomial.legendre import legvander

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.link_angles import link_angles, without_encoders
from diagnosis.behind.point_residual import PointResidual
from machine.effects.layout import ParameterSets
from machine.rotations import Array

ANGLE_OF = "an error of the angle of joint"  # that is a function of this angle: a coder, a gear, a bent shaft
LATE = "lateness that changes"
LENS = "the distance from the image's middle"
LOOKS = "how large each marker looks"  # printed in another size, taught by a wrong one
NARROW = (ANGLE_OF, LATE, LENS, LOOKS)
ANGLE_ORDER, LATE_ORDER = 5, 1
NUDGE_S = 1e-3
STILL_RAD = 2e-3  # within it an angle shows its encoder's noise, and no course; of time, in seconds, far less than any


def narrow_point_columns(measured: PointResidual, base: ParameterSets) -> dict[str, Array]:
    """(3 m, k) by what they are functions of, as white as the residual of measured points.

    What a tracker's frame or points' places that nobody knows would take up is not taken off: there they foretell less.
    """
    out = {}
    for j, moved in enumerate(measured.moved_by_each(base)):
        of_angle = _smooth(measured.data.q[:, j], ANGLE_ORDER)
        columns = (moved[:, :, None] * of_angle[:, None, :]).reshape(-1, of_angle.shape[1])
        out[f"{ANGLE_OF} {j + 1}"] = measured.noise.white(columns.T).T
    return out


def narrow_corner_columns(seen: CornerResidual, base: ParameterSets) -> dict[str, Array]:
    """(N, k) by what they are functions of, as white as the residual of corners, without what the object's place is."""
    camera = seen.nominal.camera
    if camera is None:
        return {}
    out = {
        LENS: _lens(seen.frames.pixels, np.array([camera.cx_px, camera.cy_px]), camera.fx_px),
        LOOKS: _looks(seen.frames.pixels, camera.fx_px),
    }
    if seen.on == "ooi":
        frame, plain = seen.frames.frame_of_each, without_encoders(base)
        q = link_angles(seen.paths, base, 0, seen.at, seen.frames.t_s)

        later, here = (
            seen.difference(plain, 0, seen.poses(base, plain, 0, s), None, seen.T_base_ooi) for s in (NUDGE_S, 0.0)
        )
        late = (later - here) / NUDGE_S
        out[LATE] = late[:, None] * _smooth(seen.frames.t_s, LATE_ORDER)[frame]
        for j, turned in enumerate(seen.moved_by_each(base)):
            out[f"{ANGLE_OF} {j + 1}"] = turned[:, None] * _smooth(q[:, j], ANGLE_ORDER)[frame]
    return {name: seen.placeless(columns) for name, columns in out.items()}


def _smooth(x: Array, order: int) -> Array:
    """Legendre's polynomials of values (m,) over their range (m, order + 1); of what stood still the constant alone."""
    if float(np.ptp(x)) < STILL_RAD:
        return np.ones((len(x), 1))
    middle, half = 0.5 * (x.max() + x.min()), 0.5 * float(np.ptp(x))
    return np.asarray(legvander((x - middle) / half, order), dtype=float)


def _lens(pixels: Array, centre: Array, scale: float) -> Array:
    """(N, 6): shifts, and what goes along and across the way from the middle by its powers; alike for both eyes."""
    there = np.isfinite(pixels)
    x = (pixels - centre) / scale
    r2 = (x**2).sum(axis=-1, keepdims=True)
    across = np.stack([-x[..., 1], x[..., 0]], axis=-1)
    shifts = [np.broadcast_to(row, x.shape) for row in np.eye(2)]
    return np.stack([field[there] for field in (*shifts, x, across, r2 * x, r2**2 * x)], axis=1)


def _looks(pixels: Array, scale: float) -> Array:
    """(N, markers): the way from each marker's own middle, alike for both eyes."""
    there = np.isfinite(pixels)
    corners = np.maximum(there.sum(axis=3, keepdims=True), 1)
    middle = np.where(there, pixels, 0.0).sum(axis=3, keepdims=True) / corners
    _, _, marker, _, _ = np.nonzero(there)
    own = ((pixels - middle) / scale)[there]
    return np.asarray(own[:, None] * np.eye(pixels.shape[2])[marker], dtype=float)
