"""Trajectories, commands and small steps that the tests of FB_HmMotion share."""

from dataclasses import replace

import numpy as np
from st_motion_block import DeliveredMotion, program_of
from st_motion_drive import with_number
from st_motion_pair import MS, Q_START, MotionPair, settings_of
from st_program import Program
from st_sessions import quintic

from protocol.codes import CommandFlag, Interp, Mode, RejectCode
from protocol.messages import Command, Knot, pad_to_eight_axes

CYCLE_S = 0.01
SETTINGS = settings_of(CYCLE_S)
START = Knot(0, pad_to_eight_axes(tuple(Q_START.tolist())))
STEP = np.deg2rad([6.0, -4.0, 5.0, 9.0, -8.0, 12.0])
KNOTS = (START, *quintic(START, Q_START + STEP, 2.0, 50))
FLAT = tuple(replace(START, t_ns=i * 50 * MS) for i in range(90))
END, BEGIN, TAIL = CommandFlag.LAST_IS_END, CommandFlag.START, CommandFlag.TAIL_REPLACES


_watched: list[Program] = []


def run_in(program: Program | None) -> None:
    """From now on pairs run in this program; None: in the usual one again."""
    _watched[:] = [program] if program else []


def pair_at(q: np.ndarray | None = None) -> MotionPair:
    """A pair that holds at q (n,)."""
    pair = MotionPair(DeliveredMotion(_watched[0] if _watched else program_of(CYCLE_S)), SETTINGS)
    if q is not None:
        pair.hold(q)
    return pair


def traj(first: int = 0, knots: tuple[Knot, ...] = KNOTS[:6], **fields) -> Command:
    """A trajectory command with these knots from index `first` on."""
    base = Command(1, 1, 0, mode=Mode.TRAJECTORY, traj_id=1, interp=Interp.QUINTIC, cmd_flags=BEGIN)
    return replace(base, knot_first=first, knots=knots, **fields)


def servo(q: np.ndarray, qd: np.ndarray | None = None, **fields) -> Command:
    """A servo command."""
    knot = Knot(
        0, pad_to_eight_axes(tuple(q.tolist())), pad_to_eight_axes(tuple((np.zeros(6) if qd is None else qd).tolist()))
    )
    base = Command(1, 1, 0, mode=Mode.SERVO, traj_id=1, interp=Interp.LINEAR, cmd_flags=BEGIN, knots=(knot,))
    return replace(base, **fields)


def changed(knots: tuple[Knot, ...], k: int, **fields) -> tuple[Knot, ...]:
    """The k-th knot with fields set: t_ns=..., or q=(axis, value)."""
    values = {n: v if n == "t_ns" else with_number(getattr(knots[k], n), *v) for n, v in fields.items()}
    return (*knots[:k], replace(knots[k], **values), *knots[k + 1 :])


def load_all(pair: MotionPair, knots: tuple[Knot, ...], flags: CommandFlag = BEGIN) -> None:
    """All knots, six a command; END of the flags goes with the last one only."""
    for first in range(0, len(knots), 6):
        last = first + 6 >= len(knots) and END in flags
        part_flags = flags if last else flags & ~END
        assert pair.deliver(traj(first, knots[first : first + 6], cmd_flags=part_flags)) is RejectCode.NONE


def run_out(pair: MotionPair, watch: bool = True) -> int:
    """Cycles to the end of the motion."""
    for cycles in range(1, 3000):
        if pair.cycle(watch):
            return cycles
    raise AssertionError("still moving")
