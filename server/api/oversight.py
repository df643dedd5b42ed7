"""Faults, audit and time."""

import time
from typing import Annotated, Literal

from fastapi import APIRouter, Query

from recording.clock import mono_ns
from server.api.findings import Before
from server.api.state_view import CAMERA_SILENT_MS
from server.api.views import Problem, View
from server.inner_faults import KEYS_UNREADABLE_FAULT_ID, SERVER_PART_FAILED_FAULT_ID
from server.jobs.service import JobService
from server.store.audit_rows import read_audit

# What is wrong with the machine now: one constant id per cause. A refused request is not a fault.


class FaultView(View):
    """One fault. URGENT: no new motion; WARNING: goes on."""

    fault_id: str
    level: Literal["WARNING", "URGENT"]
    text: str
    hint: str


def fault_views(service: JobService) -> list[FaultView]:
    """All of them, most severe first."""
    found = [
        *_link_faults(service),
        *_internal_faults(service),
        *_store_faults(service),
        *_camera_faults(service),
        *_recorder_faults(service),
        *_disk_faults(service),
    ]
    return sorted(found, key=lambda fault: fault.level != "URGENT")


def _link_faults(service: JobService) -> list[FaultView]:
    health = service.cell.link.health
    phase = health.phase.value
    texts = {
        "offline": (
            "plc_silent",
            "the PLC does not answer",
            health.error or "check its program, cable and address, and that no other PC holds it",
        ),
        "fault": ("plc_fault", "the PLC reports a fault", "remove its cause, then POST /v1/reset"),
        "local": ("plc_local", "the machine is in local (lever) control", "switch it back to remote at the machine"),
    }
    other = health.other_pc
    hint = "one server commands one PLC: end the other server, or give this one another PLC in [plc]"
    found = [FaultView(fault_id="plc_contested", level="WARNING", text=other, hint=hint)] if other else []
    if phase in texts:
        fault_id, text, hint = texts[phase]
        found.append(FaultView(fault_id=fault_id, level="URGENT", text=text, hint=hint))
    return found


def _internal_faults(service: JobService) -> list[FaultView]:
    hints = {
        KEYS_UNREADABLE_FAULT_ID: (
            "make the file readable to the server's user, or write it again with `longreach keys`"
        ),
        SERVER_PART_FAILED_FAULT_ID: "see the server's log and report it; restart the server if it goes on",
    }
    active = service.inner_faults.active
    return [
        FaultView(fault_id=fault_id, level="URGENT", text=active[fault_id], hint=hint)
        for fault_id, hint in hints.items()
        if fault_id in active
    ]


def _store_faults(service: JobService) -> list[FaultView]:
    problem = service.store_problem
    hint = "free space, or make the folder writable; a damaged database is moved away by hand"
    return [FaultView(fault_id="store", level="URGENT", text=problem, hint=hint)] if problem else []


def _camera_faults(service: JobService) -> list[FaultView]:
    report = service.cell.vision.latest
    age_ms = None if report is None else (mono_ns() - report.t_receive_mono_ns) * 1e-6
    if age_ms is not None and age_ms < CAMERA_SILENT_MS:
        return []
    text = "no image yet" if age_ms is None else "the camera delivers no new images"
    return [
        FaultView(fault_id="camera_silent", level="URGENT", text=text, hint="check the camera, its cable, [camera]")
    ]


def _recorder_faults(service: JobService) -> list[FaultView]:
    problem = service.recording_problem
    hint = "free space in the recordings folder, and make it writable; then start the job again"
    return [FaultView(fault_id="recorder", level="WARNING", text=problem, hint=hint)] if problem else []


def _disk_faults(service: JobService) -> list[FaultView]:
    problem = service.disk.why_short
    hint = "move old recordings away: without space nothing is recorded, and motion is refused in the end"
    text = f"the disk is nearly full: {problem}"
    return [FaultView(fault_id="disk_low", level="WARNING", text=text, hint=hint)] if problem else []


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
    """The server's clocks at one instant: estimate an offset as (t_unix_ns - (sent + received) / 2)."""

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
        rows = await service.keeper.database.read_async(lambda db: read_audit(db, before, limit))
        return [AuditView(**row) for row in rows]

    @router.get("/time", response_model=TimeView)
    async def read_time() -> TimeView:
        """The server's clocks, for the expiry of commands (Longreach-Expires)."""
        return TimeView(t_unix_ns=time.time_ns(), t_mono_ns=mono_ns(), life=life)

    return router
