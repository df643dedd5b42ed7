"""A refusal: reject code and byte offset of the payload."""

from collections.abc import Iterable
from dataclasses import dataclass

from protocol.codes import RejectCode
from protocol.layout import COMMAND_BODY_LAYOUT, KNOT_LAYOUT, KNOT_SIZE, KNOTS_OFFSET

_BODY = {field.name: field.offset for field in COMMAND_BODY_LAYOUT.fields}
_KNOT = {field.name: field.offset for field in KNOT_LAYOUT.fields}


@dataclass(frozen=True, slots=True)
class Objection:
    """One reason against a command; `field_offset` 0 means that no single field is to blame."""

    code: RejectCode
    field_offset: int = 0


def object_to(code: RejectCode, field: str) -> Objection:
    """An objection to a field of the command's body."""
    return Objection(code, _BODY[field])


def object_to_knot(code: RejectCode, k: int, field: str, axis: int = 0) -> Objection:
    """An objection to the command's k-th knot: field t_ns, q, qd or qdd, and the axis."""
    return Objection(code, KNOTS_OFFSET + k * KNOT_SIZE + _KNOT[field] + 8 * axis)


def first_of(objections: Iterable[Objection | None]) -> Objection | None:
    """The first objection, if there is any."""
    return next((objection for objection in objections if objection is not None), None)
