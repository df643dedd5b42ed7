"""A pattern of marks: the whole loop at each of them in turn."""

from collections.abc import Generator, Sequence

from recording.clock import mono_ns
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.plans.positioning import Clock, position
from server.jobs.plans.returning import return_to_start
from server.jobs.records import PatternResult, PositionResult
from server.jobs.requests import Progress, Request, UseTarget
from server.targets.contracts import AnchoredTarget


def marks_of(ctx: PlanContext, target_ids: Sequence[int]) -> tuple[AnchoredTarget, ...]:
    """The chosen marks in their order.

    Raises: JobFailedError: a number is not one of the marks that were found last.
    """
    known = {mark.target_id: mark for mark in ctx.knowledge.found_marks}
    missing = [number for number in target_ids if number not in known]
    if missing:
        raise JobFailedError(
            f"targets {missing} are not among the marks that were found last ({sorted(known) or 'none'}); search again",
            "no_such_target",
        )
    return tuple(known[number] for number in target_ids)


def visit_marks(
    ctx: PlanContext, marks: Sequence[AnchoredTarget], clock_ns: Clock = mono_ns
) -> Generator[Request, object, PatternResult]:
    """Bring the tool to each mark; between two of them back to where the first run began, which sees them all.

    The local calibration of the first is used again while it is valid. Ends at the first mark that is not reached.
    """
    results: list[PositionResult] = []
    q_start = None
    for number, mark in enumerate(marks, 1):
        if q_start is not None:
            ctx.knowledge.q_start = q_start
            yield from return_to_start(ctx)
        ctx.knowledge.use_target(mark)
        yield UseTarget(mark)
        yield Progress("pattern", float(number), float(len(marks)), "", f"mark {number} of {len(marks)}")
        results.append((yield from position(ctx, recalibrate=number == 1, clock_ns=clock_ns)))
        if q_start is None:
            q_start = ctx.knowledge.q_start
        if not results[-1].reached:
            break
    reached = len(results) == len(marks) and results[-1].reached
    reason = (
        f"{len(results)} of {len(marks)} marks reached"
        if reached
        else (f"mark {len(results)} of {len(marks)} was not reached: {results[-1].reason}")
    )
    visited = tuple(mark.target_id for mark in marks[: len(results)])
    return PatternResult(reached, reason, visited, tuple(results))
