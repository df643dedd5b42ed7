"""The shapes of what a chosen model leaves, and how many nats each one foretells."""

import math
from dataclasses import dataclass

import numpy as np

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.point_residual import PointResidual
from diagnosis.cells.behind import measurement_of
from diagnosis.families.behind import FIXED, IN_TURN, SWINGS_OF, corner_columns, point_columns, swing_columns
from diagnosis.families.common import COMMON_LEAST, Numbers, common_share, repeated_rows
from diagnosis.families.driven import SINCE, driven_columns
from diagnosis.families.gain import foretold, held_out_nats, steady_nats
from diagnosis.families.narrow import ANGLE_OF, LENS, NARROW, narrow_corner_columns, narrow_point_columns
from diagnosis.families.of_joints import OF_JOINTS, columns_of_joints
from diagnosis.families.valve import VALVE, valve_columns
from diagnosis.refusal.remainder import BEHIND_NATS, BEHIND_TIMES, Fired
from diagnosis.search.cell import DRIVEN_STAGES, EXCEEDED_TIMES, Cell
from diagnosis.search.fit import costs
from machine.remainder import USUAL_ENERGY, USUAL_SHAPE, usual_shape
from machine.rotations import Array

LEAST_NATS = 12.0  # twice the margin of a name
REFUSED_NATS = 16.0  # none of 60 recordings of the undisturbed plant were refused by it; 12 refused one
STEADY_NATS = 24.0  # twice what is told: of 97 undisturbed days none showed a joint's way by 23
RARE_NATS = 60.0  # the same for single moments
RARE_TIMES = 3.0  # of what moments show undisturbed: the sixteenth day's largest one is far larger
FORM_TIMES = 3.0  # of the share of its gain that a name's form may be wrong by: it asks for the name, this for all else
TEST = "shape"
STILL = ("static", "tool")  # measured where no boom swings: poses at rest, a marker that goes along with the camera
SINGLE_MOMENTS = "single moments"
SHAKEN = (SWINGS_OF, *NARROW, *OF_JOINTS)  # no test where a joint's unusual motion shakes what is seen
FEW = (*NARROW, *VALVE, *OF_JOINTS)  # families of a few numbers, or of one cause
LATER = (SINCE, IN_TURN, SWINGS_OF, *FEW)  # a baseline fitted before these were sought refuses nothing by them
APART = tuple(usual_shape(name) for name in (SINGLE_MOMENTS, *FEW))  # hold no other course back
ODD_SHARE = 0.02
ODD = 4.5  # floors: of ten thousand rows of noise, one in fourteen recordings
Place = tuple[str, int | None, str]


@dataclass(frozen=True, slots=True)
class Shape:
    """What a remainder is a function of, and the nats that it foretells where it was not fitted.

    `measurement`: static, tracker, ooi or tool for what was measured behind the encoders; else empty.
    """

    stage: str
    joint: int | None
    measurement: str
    goes_with: str
    nats: float


def shapes_of(cell: Cell, residual: Array, least_nats: float = LEAST_NATS) -> tuple[Shape, ...]:
    """Every shape of at least so many nats in a residual (N,), the largest first."""
    found = [one for part, own in cell.by_part(residual) for one in _of_part(part, own)] + _of_joints(cell, residual)
    return tuple(sorted((one for one in found if one.nats >= least_nats), key=lambda one: -one.nats))


def left_shapes(cell: Cell, residual: Array, gained_nats: float) -> tuple[Shape, ...]:
    """The shapes of what a chosen model leaves (N,), the largest first; where a baseline says what the undisturbed
    machine shows, only beyond that, and beyond what the form of the names that gained so much may be wrong by.
    """
    form = FORM_TIMES * cell.form_share * gained_nats
    usual = _usual(cell)
    found = tuple(one for one in shapes_of(cell, residual) if one.nats > _allowed(one, usual[_at(one)], form))
    repeats = repeated_rows(cell)
    return _in_common(cell, residual, found, repeats) if found and repeats else found


def _in_common(cell: Cell, residual: Array, found: tuple[Shape, ...], repeats: list[Numbers]) -> tuple[Shape, ...]:
    """Those of a joint's shapes that foretell the same of each repeat, and not each one's own noise."""
    columns = _columns(cell)
    return tuple(
        one
        for one in found
        if one.goes_with not in columns
        or common_share(residual, foretold(columns[one.goes_with], residual, cell.rows), repeats) >= COMMON_LEAST
    )


def refusing(cell: Cell, left: tuple[Shape, ...], gained_nats: float) -> tuple[Fired, ...]:
    """Shapes of a chosen model's remainder that speak against it: beyond the largest one of its place undisturbed.

    Why: a swing that went with the acceleration fifteen times goes with the posture or with time on the sixteenth day.
         Without a baseline nothing is refused: the form of a model that never met its machine would speak against
         every name. What a joint leaves that moved unlike any undisturbed recording is a lead only.
    """
    usual = _usual(cell)
    form = FORM_TIMES * cell.form_share * gained_nats
    out = []
    for one in left:
        known = usual[_at(one)]
        if not _is_test(cell, one, known):
            continue
        if _known(known) and one.nats > _refused_from(known, one) + form:
            share = one.nats / (one.nats + max(gained_nats, 0.0))
            lead = f"goes with {one.goes_with}"
            out.append(Fired(TEST, one.stage, one.joint, one.nats, math.exp(-one.nats), lead, share))
    return tuple(out)


def _is_test(cell: Cell, shape: Shape, known: dict[str, float]) -> bool:
    """Whether a shape can speak against a model at all, by what is known of its place and of how the joints moved."""
    if cell.knocked or shape.joint in cell.moved_unlike:
        return False
    swings = shape.measurement not in STILL
    if cell.moved_unlike and shape.goes_with.startswith(SHAKEN) and swings:
        return False
    if cell.stuck and shape.goes_with == SINGLE_MOMENTS and swings:  # each jump of that joint is one
        return False
    if shape.goes_with.startswith(FEW) and USUAL_ENERGY not in known:  # few days do not tell what the most is
        return False
    return not shape.goes_with.startswith(LATER) or usual_shape(shape.goes_with) in known


def instead(cell: Cell, nothing: Array, gained_nats: float) -> tuple[Fired, ...]:
    """Names that stand in for what has none: time since the start foretells far more than they gain.

    Why: where such names take up most of that course, too little of it is left in their remainder.
    Args: nothing: (N,) the held-out residual of the baseline alone; gained_nats: what the names gain over that.
    """
    usual, more = _usual(cell), []
    for part, residual in cell.by_part(nothing):
        B = _columns(part).get(SINCE)
        if B is not None and usual_shape(SINCE) in usual[_place(part)]:
            more.append(Shape(*_place(part), SINCE, held_out_nats(B, residual, part.rows) - gained_nats))
    return refusing(cell, tuple(more), gained_nats)


def _refused_from(usual: dict[str, float], shape: Shape) -> float:
    """Its own usual size, or any course's that is larger there; single moments are no course, and rarer.

    Where nothing swings only its own: what goes with another course on another day is a swing. So of swings, too, of
    time since the start, which no motion goes with, of families of few numbers, and of what stays with a point or a
    marker. An angle's error of what swings, and what all measurements show of a joint: that of any joint, since few
    days show it of each. Of a place in the image and the distance from its middle, where something swings, that of any
    course: it is where the swing is (30 to 56 nats on days without a fault of the camera).
    """
    own, still = usual.get(usual_shape(shape.goes_with), 0.0), shape.measurement in STILL
    if shape.goes_with.startswith(ANGLE_OF) and not still:  # booms follow a large fault of the actuators, too
        return BEHIND_NATS + BEHIND_TIMES * _most_of_any_joint(usual, ANGLE_OF)
    family = next((one for one in OF_JOINTS if shape.goes_with.startswith(one)), None)
    if family is not None:
        return STEADY_NATS + EXCEEDED_TIMES * _most_of_any_joint(usual, family)
    own_only = still or (shape.goes_with.startswith(LATER) and shape.goes_with != LENS)
    if own_only and shape.goes_with != SINGLE_MOMENTS:
        return REFUSED_NATS + EXCEEDED_TIMES * own
    courses = [nats for name, nats in usual.items() if name.startswith(USUAL_SHAPE) and not name.startswith(APART)]
    most = own if shape.goes_with in FIXED else max([own, *courses])
    if shape.goes_with == SINGLE_MOMENTS:
        return RARE_NATS + RARE_TIMES * most
    if shape.stage not in DRIVEN_STAGES:
        return BEHIND_NATS + BEHIND_TIMES * most
    return REFUSED_NATS + EXCEEDED_TIMES * most


def _most_of_any_joint(usual: dict[str, float], family: str) -> float:
    """What undisturbed days showed of a family's joints at the most."""
    return max((nats for name, nats in usual.items() if name.startswith(usual_shape(family))), default=0.0)


def _usual(cell: Cell) -> dict[Place, dict[str, float]]:
    return {_place(part): dict(part.usual) for part in cell.parts or (cell,)}


def _known(usual: dict[str, float]) -> bool:
    return any(name.startswith(USUAL_SHAPE) for name in usual)


def _allowed(shape: Shape, usual: dict[str, float], form_nats: float) -> float:
    if shape.goes_with in VALVE and usual_shape(shape.goes_with) not in usual:
        return math.inf  # the valve's wide families say it there
    if not _known(usual):
        return LEAST_NATS
    return LEAST_NATS + EXCEEDED_TIMES * usual.get(usual_shape(shape.goes_with), 0.0) + form_nats


def _place(part: Cell) -> Place:
    return part.stage, part.joint, measurement_of(part)


def _at(shape: Shape) -> Place:
    return shape.stage, shape.joint, shape.measurement


def _of_part(part: Cell, residual: Array) -> list[Shape]:
    nats = {name: held_out_nats(B, residual, part.rows) for name, B in _columns(part).items()}
    nats |= {SINGLE_MOMENTS: _odd_nats(residual)}
    return [Shape(*_place(part), name, one) for name, one in nats.items()]


def _of_joints(cell: Cell, residual: Array) -> list[Shape]:
    """What all measurements behind the joints show of one joint alike, told of the first of them."""
    part, columns = columns_of_joints(cell)
    return [Shape(*_place(part), name, steady_nats(B, residual, cell.rows)) for name, B in columns.items()]


def _columns(part: Cell) -> dict[str, Array]:
    if isinstance(part.whitened, PointResidual):
        wide = {**point_columns(part.whitened), **swing_columns(part.whitened, part.base)}
        return wide | narrow_point_columns(part.whitened, part.base)
    if isinstance(part.whitened, CornerResidual):
        return corner_columns(part.whitened) | narrow_corner_columns(part.whitened, part.base)
    return driven_columns(part) | valve_columns(part)


def _odd_nats(residual: Array) -> float:
    """Cost of the few residuals that noise hardly ever gives: what is rare has no course that others foretell. 0 where
    many are odd: that is no matter of moments.
    """
    odd = np.abs(residual) > ODD
    return float(costs(residual[odd]).sum()) if np.mean(odd) <= ODD_SHARE else 0.0
