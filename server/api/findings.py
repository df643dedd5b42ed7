"""What jobs found: looks, calibrations, plans by hash."""

import json
from collections import deque
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import JSONResponse

from recording.clock import mono_ns
from server.api.problems import problem_response
from server.api.views import ErrorView, Problem, View
from server.jobs.engine import Job, JobEvent
from server.jobs.records import LookRecord
from server.jobs.service import JobService
from server.store.audit_rows import read_calibrations, read_plan

LOOKS_KEPT = 200
PlanHash = Annotated[str, Path(pattern=r"^[0-9a-f]{16}$", description="as returned by the preview")]
Limit = Annotated[int, Query(ge=1, le=200)]
Before = Annotated[int, Query(ge=1, le=2**62, description="only numbers below this one; for the next page")]


class LookEntry(View):
    """One look of this life of the server."""

    number: int
    t_unix_s: float
    job_id: str
    status: str
    reason: str
    error: ErrorView | None
    n_used: int


class CalibrationEntry(View):
    """One calibration that a job left behind."""

    number: int
    made_unix_s: float
    job_id: str
    method: str
    sigma_deg: float
    residual_rms_mm: float
    view: dict[str, Any]


class PlanEntry(View):
    """A previewed plan. Expired: Execute refuses it."""

    plan_hash: str
    job_id: str
    made_unix_s: float
    expires_unix_s: float
    expired: bool
    view: dict[str, Any]


class LookLog:
    """Listener of the engine: the looks of this life, newest last."""

    def __init__(self, service: JobService) -> None:
        self._service = service
        self._last: LookRecord | None = None
        self.entries: deque[LookEntry] = deque(maxlen=LOOKS_KEPT)
        service.engine.on_event(self._append_new_look)

    def _append_new_look(self, job: Job, _event: JobEvent) -> None:
        taken = self._service.cell.knowledge.last_look
        if taken is None or taken.record is self._last:
            return
        self._last = record = taken.record
        self.entries.append(
            LookEntry(
                number=self.entries[-1].number + 1 if self.entries else 1,
                t_unix_s=round(self._service.cell.knowledge.unix_s(record.t_mono_ns), 3),
                job_id=job.job_id,
                status=record.status,
                reason=record.reason,
                error=ErrorView.model_validate(record.error, from_attributes=True) if record.error else None,
                n_used=record.n_used,
            )
        )


def findings_router(service: JobService, looks: LookLog) -> APIRouter:
    """Routes /v1/looks, /v1/calibrations, /v1/plans/{plan_hash}."""
    router = APIRouter(prefix="/v1", tags=["findings"])

    @router.get("/looks", response_model=list[LookEntry])
    async def read_looks(limit: Limit = 50) -> list[LookEntry]:
        """The last looks since the server started, newest first."""
        return list(reversed(looks.entries))[:limit]

    @router.get("/calibrations", response_model=list[CalibrationEntry], responses={503: {"model": Problem}})
    async def list_calibrations(limit: Limit = 50, before: Before = 2**62) -> list[CalibrationEntry]:
        """All calibrations made by jobs, newest first; /v1/calibration is the current one."""
        if service.keeper is None:
            return []
        rows = await service.keeper.database.read_async(lambda db: read_calibrations(db, before, limit))
        return [CalibrationEntry(**row | {"view": json.loads(row["view"])}) for row in rows]

    found: dict[int | str, dict[str, Any]] = {404: {"model": Problem}, 503: {"model": Problem}}

    @router.get("/plans/{plan_hash}", response_model=PlanEntry, responses=found)
    async def show_plan(plan_hash: PlanHash) -> PlanEntry | JSONResponse:
        """A plan by its hash, expired or not."""
        row, expires_ns = None, 0
        if service.keeper is not None:
            expires_ns = service.keeper.plan_expiries_ns.get(plan_hash, 0)
            row = await service.keeper.database.read_async(lambda db: read_plan(db, plan_hash))
        if row is None:
            return problem_response(
                404, "Unknown plan", f"no plan {plan_hash}", "unknown_plan", "run the job 'preview'"
            )
        expired = mono_ns() > expires_ns  # as execution has it: the wall clock may be set meanwhile
        return PlanEntry(**row | {"view": json.loads(row["view"]), "expired": expired})

    return router
