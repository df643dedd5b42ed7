"""The calibration over REST: shown, and exported as a file for other programs."""

from typing import Any, Literal

from fastapi import APIRouter
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from recording.clock import mono_ns
from server.api.calibration_view import calibration_view, validity_now
from server.api.problems import problem
from server.api.views import CalibrationView, Problem
from server.calibration.calibration_export import as_ros, as_yaml
from server.calibration.calibration_file import SavedCalibration, calibration_text
from server.jobs.service import JobService

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
        return calibration_view(cell, service.context, mono_ns()) or _none(service)

    @router.get("/export", response_model=None, response_class=Response, responses=EXPORTED)
    async def export_calibration(format: Literal["yaml", "ros", "json"] = "yaml") -> PlainTextResponse | JSONResponse:
        """The calibration as YAML, as a ROS static transform, or as longreach's own file (JSON)."""
        life = cell.knowledge.life
        if life is None:
            return _none(service)
        if format == "json":
            saved = SavedCalibration(life, tuple(cell.knowledge.runs))
            return PlainTextResponse(calibration_text(saved), media_type="application/json")
        validity = validity_now(cell, service.context, life, mono_ns())
        text = as_ros(life, validity) if format == "ros" else as_yaml(life, validity)
        return PlainTextResponse(text, media_type="application/yaml")

    return router


def _none(service: JobService) -> JSONResponse:
    note = service.cell.knowledge.calibration_note
    return problem(
        404, "No calibration", note or "there is no calibration yet; run the job 'calibrate'", "no_calibration"
    )
