"""State, health and readiness over REST."""

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response

from server.api.state_view import state_view
from server.api.views import StateView
from server.jobs.service import JobService


def state_router(service: JobService) -> APIRouter:
    """Routes /v1/state, /v1/camera.jpg, /healthz, /readyz."""
    router = APIRouter(tags=["state"])

    @router.get("/v1/state", response_model=StateView)
    async def read_state() -> StateView:
        """Everything one screen needs, at one instant."""
        return state_view(service.cell, service.engine, service.context)

    @router.get("/v1/camera.jpg", response_model=None)
    async def picture() -> Response:
        """The newest camera picture, left eye."""
        preview = service.cell.vision.latest_preview
        if preview is None:
            return JSONResponse({"detail": "no image yet: check the camera"}, status_code=503)
        return Response(preview[0], media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @router.get("/healthz")
    async def health() -> dict[str, str]:
        """The process lives."""
        return {"status": "ok"}

    @router.get("/readyz", response_model=None)
    async def ready() -> JSONResponse:
        """Whether a job could start now; 503 with the reasons when not."""
        view = state_view(service.cell, service.engine, service.context)
        reasons = [reason for reason in [view.steps["look"]] if reason]
        if view.camera.age_ms is None or view.camera.age_ms > 1000.0:
            reasons.append("the camera gives no images: check its cable and [camera] settings")
        return JSONResponse({"ready": not reasons, "reasons": reasons}, status_code=503 if reasons else 200)

    return router
