"""The calibration over REST: shown, and exported as a file for other programs."""

from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from fastapi import APIRouter
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from recording.clock import mono_ns
from server.api.problems import problem_response
from server.api.views import CalibrationView, Problem
from server.calibration.calibration_export import as_ros, as_yaml
from server.calibration.calibration_file import SavedCalibration, calibration_text
from server.calibration.calibration_life import (
    CalibrationValidity,
    LocalCalibration,
    ValidityStatus,
    observability_text,
)
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.service import JobService
from server.link.contracts import measured_oil_c

# The calibration as it is shown and handed on: its age, how well it is known, where it holds, why it does not.

UNKNOWN_POSITION_VALIDITY = CalibrationValidity(
    ValidityStatus.VALID, "the machine's position is unknown: no state received from the PLC"
)


def calibration_view(cell: Cell, ctx: PlanContext, t_mono_ns: int) -> CalibrationView | None:
    """The view; None while nothing is calibrated."""
    record, life = cell.knowledge.calibration_record, cell.knowledge.kept_calibration
    if record is None:
        return None
    if life is None:
        return CalibrationView(**asdict(record))
    found = validity_now(cell, ctx, life, t_mono_ns)
    limits = life.expiry
    return CalibrationView(
        **asdict(record),
        valid=found.ok,
        expiry_reason=found.reason,
        age_s=round(cell.knowledge.unix_s(t_mono_ns) - life.made_at.t_unix_s, 1),
        made_unix_s=round(life.made_at.t_unix_s, 3),
        sigmas_deg=[round(float(value), 4) for value in np.rad2deg(life.sigmas_rad)],
        observability_text=observability_text(life),
        path_length_m=round(life.path_length_m, 4),
        radius_mm=round(1e3 * limits.radius_m, 1),
        distance_mm=_distance_mm(cell, ctx, life),
        age_max_h=round(limits.age_max_s / 3600.0, 3),
        map_looks=0 if life.local_map is None else life.local_map.n_looks,
    )


def validity_now(cell: Cell, ctx: PlanContext, life: LocalCalibration, t_mono_ns: int) -> CalibrationValidity:
    """Whether it holds with the machine as the PLC last reported it."""
    latest, t_unix_s = cell.link.latest, cell.knowledge.unix_s(t_mono_ns)
    if latest is None:
        found = life.valid_at(t_unix_s, life.made_at.q, life.made_at.T_base_tcp)
        return UNKNOWN_POSITION_VALIDITY if found.ok else found
    q = np.array(latest.q_rad)
    return life.valid_at(t_unix_s, q, ctx.tcp(q), measured_oil_c(latest))


def _distance_mm(cell: Cell, ctx: PlanContext, life: LocalCalibration) -> float | None:
    latest = cell.link.latest
    if latest is None:
        return None
    here = ctx.tcp(np.array(latest.q_rad))[:3, 3]
    return round(1e3 * float(np.linalg.norm(here - life.made_at.T_base_tcp[:3, 3])), 1)


EXPORTED: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "the calibration",
        "content": {
            "application/yaml": {"schema": {"type": "string"}},
            "application/json": {"schema": {"type": "object"}},
        },
    },
    404: {"model": Problem},
}


def calibration_router(service: JobService) -> APIRouter:
    """Routes /v1/calibration and /v1/calibration/export."""
    router = APIRouter(prefix="/v1/calibration", tags=["calibration"])
    cell = service.cell

    @router.get("", response_model=CalibrationView, responses={404: {"model": Problem}})
    async def read_calibration() -> CalibrationView | JSONResponse:
        """The current local calibration; 404 with the reason if there is none."""
        return calibration_view(cell, service.context, mono_ns()) or _no_calibration_response(service)

    @router.get("/export", response_model=None, response_class=Response, responses=EXPORTED)
    async def export_calibration(format: Literal["yaml", "ros", "json"] = "yaml") -> PlainTextResponse | JSONResponse:
        """The calibration as YAML, as a ROS static transform, or as longreach's own file (JSON)."""
        life = cell.knowledge.kept_calibration
        if life is None:
            return _no_calibration_response(service)
        if format == "json":
            saved = SavedCalibration(life, tuple(cell.knowledge.odometry_runs))
            return PlainTextResponse(calibration_text(saved), media_type="application/json")
        validity = validity_now(cell, service.context, life, mono_ns())
        text = as_ros(life, validity) if format == "ros" else as_yaml(life, validity)
        return PlainTextResponse(text, media_type="application/yaml")

    return router


def _no_calibration_response(service: JobService) -> JSONResponse:
    note = service.cell.knowledge.calibration_note
    return problem_response(
        404, "No calibration", note or "there is no calibration yet; run the job 'calibrate'", "no_calibration"
    )
