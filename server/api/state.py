"""State, health and readiness over REST."""

from collections.abc import Callable
from typing import Any, Literal

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from recording.clock import mono_s
from server.api.problems import problem_response
from server.api.state_view import CAMERA_SILENT_MS, state_view
from server.api.views import Problem, StateView, View
from server.camera.client import STARTING_STATUS_TEXT
from server.jobs.service import JobService

# The state as JSON text, made at most 20 times a second however many ask.

STATE_CACHE_TTL_S = 0.05


class StateCache:
    """Belongs to the event loop."""

    def __init__(self, service: JobService, clock: Callable[[], float] = mono_s) -> None:
        self._service, self._clock = service, clock
        self._text, self._made_s = "", float("-inf")

    def fresh_text(self) -> str:
        """Not older than STATE_CACHE_TTL_S."""
        now_s = self._clock()
        if now_s - self._made_s > STATE_CACHE_TTL_S:
            service = self._service
            self._text = state_view(
                service.cell, service.engine, service.context, service.store_problem
            ).model_dump_json()
            self._made_s = now_s
        return self._text

    def answer(self) -> Response:
        """The text as an answer to a GET."""
        return Response(self.fresh_text(), media_type="application/json", headers={"Cache-Control": "no-store"})


class StraightState:
    """GET /v1/state as an ASGI application: what fleets ask most often, without the framework's share of its cost."""

    def __init__(self, states: StateCache) -> None:
        self._states = states

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        await self._states.answer()(scope, receive, send)


def straight_route(states: StateCache) -> Route:
    """To stand before the documented route of the same path, which describes this one's answers in the document."""
    route = Route("/v1/state", StraightState(states), include_in_schema=False)
    route.methods = {"GET"}  # Starlette adds HEAD, which the document does not have
    return route


PICTURE: dict[int | str, dict[str, Any]] = {
    200: {"description": "the picture", "content": {"image/jpeg": {"schema": {"type": "string"}}}},
    503: {"model": Problem, "description": "no image yet"},
}


class HealthView(View):
    """Whether the process is alive."""

    status: Literal["ok"] = "ok"


class ReadyView(View):
    """Whether a job could start now."""

    ready: bool
    reasons: list[str]


def state_router(service: JobService, cache: StateCache | None = None) -> APIRouter:
    """Routes /v1/state, /v1/camera.jpg, /healthz, /readyz."""
    router = APIRouter(tags=["state"])
    states = cache or StateCache(service)

    @router.get("/v1/state", response_model=StateView)
    async def read_state() -> Response:
        """State of machine, link, camera and jobs at one instant, at most 50 ms old."""
        return states.answer()

    @router.get("/v1/camera.jpg", response_model=None, response_class=Response, responses=PICTURE)
    async def camera_picture() -> Response:
        """The newest camera image, left eye."""
        preview = service.cell.vision.latest_preview
        if preview is None:
            return problem_response(503, "No picture", "no image yet", "no_picture", "check the camera")
        return Response(preview[0], media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @router.get("/healthz", response_model=HealthView)
    async def health() -> HealthView:
        """Whether the process is alive."""
        return HealthView()

    @router.get("/readyz", response_model=ReadyView, responses={503: {"model": ReadyView}})
    async def ready() -> JSONResponse:
        """Whether a job could start now; 503 with the reasons when not."""
        reasons = why_not_ready(service)
        ready = ReadyView(ready=not reasons, reasons=reasons)
        return JSONResponse(ready.model_dump(), status_code=503 if reasons else 200)

    return router


def why_not_ready(service: JobService) -> list[str]:
    """Why no job could start now; empty when one could."""
    view = state_view(service.cell, service.engine, service.context)  # the store's reason comes by itself
    reasons = [reason for reason in [view.steps["look"]] if reason]
    stream = service.cell.vision.stream_text
    if (camera := camera_reason(view.camera.age_ms, stream)) is not None:
        reasons.append(camera)
    if service.store_problem:
        reasons.append(f"the database cannot be written: {service.store_problem}")
    if service.disk.why_short:
        reasons.append(f"the disk is nearly full: {service.disk.why_short}: move old recordings away")
    return [*reasons, *service.inner_faults.active.values()]


def camera_reason(age_ms: float | None, stream: str = "") -> str | None:
    """Why no look could be taken with a newest picture of this age [ms]; None: it could. `stream`: what its source
    reports of itself.
    """
    if age_ms is None and stream == STARTING_STATUS_TEXT:
        return stream
    if age_ms is None:
        return "the camera delivers no images: check its cable and [camera] settings"
    if age_ms > CAMERA_SILENT_MS:
        old = f"{age_ms / 1e3:.1f} s old (limit {CAMERA_SILENT_MS / 1e3:.1f} s)"
        return f"the camera's newest image is {old}: check its cable, its rate and how busy its computer is"
    return None
