"""Axis limits that both ends enforce, and the id by which they verify that their tables are equal."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from protocol.errors import LocalProtocolError
from protocol.layout import LIMIT_TABLE_LAYOUT, N_AXIS_SLOTS
from protocol.timeouts import KNOT_SPACING_MAX_NS, KNOT_SPACING_MIN_NS, START_TOLERANCE_RAD


class JointLimits(Protocol):
    """What a joint of a machine description must offer (machine.description.Joint does)."""

    @property
    def name(self) -> str:
        """Joint name."""
        ...

    @property
    def q_min_rad(self) -> float:
        """Lower end of the range [rad]."""
        ...

    @property
    def q_max_rad(self) -> float:
        """Upper end of the range [rad]."""
        ...

    @property
    def qd_max_rad_s(self) -> float:
        """Largest speed [rad/s]."""
        ...

    @property
    def qdd_max_rad_s2(self) -> float:
        """Largest acceleration [rad/s^2]."""
        ...


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """One axis: range [rad], speed [rad/s], acceleration [rad/s^2]."""

    name: str
    q_min: float
    q_max: float
    qd_max: float
    qdd_max: float


@dataclass(frozen=True, slots=True)
class LimitTable:
    """All axes in use, 1..8, and the rules on knots that go with them."""

    axes: tuple[AxisLimits, ...]
    spacing_min_ns: int = KNOT_SPACING_MIN_NS
    spacing_max_ns: int = KNOT_SPACING_MAX_NS
    start_tolerance_rad: float = START_TOLERANCE_RAD


def limits_of(joints: Iterable[JointLimits]) -> LimitTable:
    """The table of a machine's joints. Raises: LocalProtocolError: not 1..8 joints."""
    axes = tuple(AxisLimits(j.name, j.q_min_rad, j.q_max_rad, j.qd_max_rad_s, j.qdd_max_rad_s2) for j in joints)
    if not 1 <= len(axes) <= N_AXIS_SLOTS:
        raise LocalProtocolError(
            f"machine: {len(axes)} joints, the link carries 1..{N_AXIS_SLOTS}; leave the others out"
        )
    return LimitTable(axes)


def axis_mask(table: LimitTable) -> int:
    """One bit per axis in use."""
    return (1 << len(table.axes)) - 1


def cfg_id(table: LimitTable) -> int:
    """CRC-32 of the table packed as LIMIT_TABLE_LAYOUT, unused axes 0: a PLC computes it from its own constants."""
    columns = zip(*((a.q_min, a.q_max, a.qd_max, a.qdd_max) for a in table.axes), strict=True)
    numbers = [float(x) for column in columns for x in (*column, *(0.0,) * (N_AXIS_SLOTS - len(table.axes)))]
    head = (len(table.axes), 0, table.spacing_min_ns, table.spacing_max_ns, table.start_tolerance_rad)
    return zlib.crc32(LIMIT_TABLE_LAYOUT.codec.pack(*head, *numbers))
