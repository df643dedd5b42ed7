"""Faults, audit and time."""

import time
from typing import Annotated

from fastapi import APIRouter, Query

from recording.clock import mono_ns
from server.api.fault_list import FaultView, fault_views
from server.api.findings import Before
from server.api.views import Problem, View
from server.jobs.service import JobService
from server.store.audit_rows import read_audit


class AuditView(View):
    """One line of the audit."""

    number: int
    t_unix_s: float
    who: str
    role: str
    address: str
    action: str
    outcome: str
    lease_owner: str
    fencing: int
    request_id: str
    idempotency_key: str
    plan_hash: str
    job_id: str
    detail: str


class TimeView(View):
    """The server's clocks at one instant: estimate an offset as (t_unix - (sent + received) / 2)."""

    t_unix_ns: int
    t_mono_ns: int
    life: str


def oversight_router(service: JobService, life: str) -> APIRouter:
    """Routes /v1/faults, /v1/audit, /v1/time."""
    router = APIRouter(prefix="/v1", tags=["oversight"])

    @router.get("/faults", response_model=list[FaultView])
    async def list_faults() -> list[FaultView]:
        """The present faults of machine and server, most severe first."""
        return fault_views(service)

    @router.get("/audit", response_model=list[AuditView], responses={503: {"model": Problem}})
    async def list_audit(limit: Annotated[int, Query(ge=1, le=1000)] = 100, before: Before = 2**62) -> list[AuditView]:
        """Who commanded what and what came of it, newest first. For operators, engineers and admins."""
        if service.keeper is None:
            return []
        rows = await service.keeper.database.found(lambda db: read_audit(db, before, limit))
        return [AuditView(**row) for row in rows]

    @router.get("/time", response_model=TimeView)
    async def read_time() -> TimeView:
        """The server's clocks, for the expiry of commands (Longreach-Expires)."""
        return TimeView(t_unix_ns=time.time_ns(), t_mono_ns=mono_ns(), life=life)

    return router
