"""The goal as the operator sets it: every plan reads it from the context's settings, so it is changed there."""

from dataclasses import replace

from server.errors import BusyError
from server.jobs.plans.looking import against_goal
from server.jobs.service import JobService
from server.settings import PositionSettings


def set_goal(service: JobService, stand_off_mm: float, offset_x_mm: float, offset_y_mm: float) -> None:
    """From now on plan to there. The last look is judged anew; the previewed plan, made for the old goal, is dropped.

    Raises: BusyError: a job is running and keeps the goal it began with.
    """
    job = service.engine.current
    if job is not None and not job.ended:
        raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; set the goal after it")
    context, knowledge = service.context, service.cell.knowledge
    goal = {"stand_off_mm": stand_off_mm, "offset_x_mm": offset_x_mm, "offset_y_mm": offset_y_mm}
    position = PositionSettings.model_validate(context.settings.position.model_dump() | goal)
    service.context = replace(context, settings=context.settings.model_copy(update={"position": position}))
    knowledge.previewed = None
    if knowledge.last_look is not None:
        knowledge.last_look = against_goal(service.context, knowledge.last_look)
