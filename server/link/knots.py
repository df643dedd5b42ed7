"""A planned trajectory as the knots of a run request."""

from collections.abc import Iterable, Sequence

from protocol.gate import Refusal
from protocol.messages import Knot, axes8
from server.link.errors import LinkRefusedError
from server.motion.contracts import JointTrajectory

_REFUSALS_SHOWN = 3
KnotTuple = tuple[int, tuple[float, ...], tuple[float, ...], tuple[float, ...]]


def knots_from(tuples: Iterable[KnotTuple]) -> tuple[Knot, ...]:
    """The knots of a request as the link takes them."""
    return tuple(Knot(t, axes8(q), axes8(qd), axes8(qdd)) for t, q, qd, qdd in tuples)


def refusals_text(refusals: Sequence[Refusal]) -> str:
    """The motion gate's reasons in one line: the first three, and how many more."""
    shown = "; ".join(refusal.text for refusal in refusals[:_REFUSALS_SHOWN])
    more = len(refusals) - _REFUSALS_SHOWN
    return f"motion gate: {shown}" + (f"; and {more} more" if more > 0 else "")


def knots_of(trajectory: JointTrajectory, joints: int) -> tuple[KnotTuple, ...]:
    """The trajectory's own knots, times in whole nanoseconds; nothing is resampled.

    Raises: LinkRefusedError: shapes do not fit the machine.
    """
    n = len(trajectory.t_s)
    for name, array in (("q", trajectory.q), ("qd", trajectory.qd), ("qdd", trajectory.qdd)):
        if array.shape != (n, joints):
            raise LinkRefusedError(f"trajectory.{name}: shape {array.shape}, must be {(n, joints)} (knots, joints)")
    times_ns = [round(float(t) * 1e9) for t in trajectory.t_s]
    rows = zip(times_ns, trajectory.q.tolist(), trajectory.qd.tolist(), trajectory.qdd.tolist(), strict=True)
    return tuple((t, tuple(q), tuple(qd), tuple(qdd)) for t, q, qd, qdd in rows)
