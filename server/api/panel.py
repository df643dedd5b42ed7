"""The panel on the API's port: our page at /, its files at /static, and everything that feeds it."""

import html
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Annotated, Any

import httpx
from fastapi import APIRouter, Depends, FastAPI
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from pydantic import Field

from machine.field_units import unit_of
from server.access.lease import Lease
from server.api.hold import hold_router
from server.api.lease import require_lease
from server.api.live import LiveFeed, live_router
from server.api.panel_alarm_catalogue import CATALOGUE, AlarmKind
from server.api.panel_memory import PanelMemory
from server.api.panel_recordings import recordings_router
from server.api.panel_scene import SceneFeed, scene_router
from server.api.panel_view import GoalView
from server.api.problems import problem_response
from server.api.video import video_router
from server.api.views import Problem, Strict, View
from server.errors import BusyError
from server.inner_faults import SERVER_PART_FAILED_FAULT_ID
from server.jobs.plans.looking import against_goal
from server.jobs.service import JobService
from server.settings import PositionSettings
from server.supervised_tasks import SupervisedTasks
from web import STATIC_FOLDER

# Requests of the page other than jobs and lease: goal, accept, acknowledge, settings, help.

HELP_CSP = "default-src 'none'; style-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


# The goal as the operator sets it: every plan reads it from the context's settings, so it is changed there.


def set_goal(service: JobService, stand_off_mm: float, offset_x_mm: float, offset_y_mm: float) -> None:
    """Plan to this goal from now on. The last look is judged again; the previewed plan for the old goal is dropped.

    Raises: BusyError: a job is running and keeps the goal it began with.
    """
    job = service.engine.current
    if job is not None and not job.has_ended:
        raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; set the goal after it")
    context, knowledge = service.context, service.cell.knowledge
    goal = {"stand_off_mm": stand_off_mm, "offset_x_mm": offset_x_mm, "offset_y_mm": offset_y_mm}
    position = PositionSettings.model_validate(context.settings.position.model_dump() | goal)
    service.context = replace(context, settings=context.settings.model_copy(update={"position": position}))
    knowledge.previewed_plan = None
    if knowledge.last_look is not None:
        knowledge.last_look = against_goal(service.context, knowledge.last_look)


class GoalRequest(Strict):
    """Where the tool is to stand: on the target's normal, shifted in the target's plane."""

    stand_off_mm: Annotated[float, Field(ge=50.0, le=1000.0)]
    offset_x_mm: Annotated[float, Field(ge=-300.0, le=300.0)] = 0.0
    offset_y_mm: Annotated[float, Field(ge=-300.0, le=300.0)] = 0.0


class SettingRow(View):
    """One setting, to be read; it is changed in the settings file."""

    name: str
    value: str
    unit: str


def panel_router(service: JobService, memory: PanelMemory) -> APIRouter:
    """Routes /v1/goal, /v1/accept, /v1/alarms, /v1/settings and /help."""
    router = APIRouter(tags=["panel"])
    control = require_lease(service.engine.leases)
    refused: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (403, 404, 409, 422)}

    @router.put("/v1/goal", response_model=GoalView, responses=refused, dependencies=[Depends(control)])
    async def put_goal(request: GoalRequest) -> GoalView:
        """Set the goal for the next preview; a plan previewed for another goal is discarded."""
        set_goal(service, request.stand_off_mm, request.offset_x_mm, request.offset_y_mm)
        goal = service.context.settings.position
        return GoalView(stand_off_mm=goal.stand_off_mm, offset_x_mm=goal.offset_x_mm, offset_y_mm=goal.offset_y_mm)

    @router.post("/v1/accept", status_code=204, response_model=None, responses=refused)
    async def accept_tool(lease: Annotated[Lease, Depends(control)]) -> JSONResponse | None:
        """Accept the last look as the result."""
        reason = memory.accept(lease.owner)
        return problem_response(409, "Not accepted", reason, "not_acceptable") if reason else None

    @router.post("/v1/alarms/{code}/acknowledge", status_code=204, response_model=None, responses=refused)
    async def acknowledge(code: str, lease: Annotated[Lease, Depends(control)]) -> JSONResponse | None:
        """Acknowledge an alarm; this never starts a motion."""
        found = memory.alarm_book.acknowledge(code, lease.owner)
        return (
            None if found else problem_response(404, "No such alarm", f"no alarm {code[:40]!r} is on", "no_such_alarm")
        )

    @router.get("/v1/settings", response_model=list[SettingRow])
    async def list_settings() -> list[SettingRow]:
        """The resolved settings with units; of secrets only the file names."""
        return setting_rows(service.context.settings.model_dump())

    @router.get("/help/alarms/{code}", include_in_schema=False, response_model=None)
    async def help_page(code: str) -> HTMLResponse | JSONResponse:
        kind = CATALOGUE.get(code)
        if kind is None:
            return problem_response(404, "No such page", f"there is no alarm {code[:40]!r}", "no_such_alarm")
        return HTMLResponse(_alarm_help_html(kind), headers={"Content-Security-Policy": HELP_CSP})

    return router


def setting_rows(settings: dict[str, Any], prefix: str = "") -> list[SettingRow]:
    """One row a setting, sections in the name, units from the name's ending (the longest that fits)."""
    rows: list[SettingRow] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            rows += setting_rows(value, f"{prefix}{name}.")
            continue
        text = "not set" if value is None else str(value)
        rows.append(SettingRow(name=prefix + name, value=text, unit=unit_of(name)))
    return rows


def _alarm_help_html(kind: AlarmKind) -> str:
    rows = (("Cause", kind.cause), ("What to do", kind.remedy), ("Who may clear it", kind.clears))
    body = "".join(f"<h2>{title}</h2><p>{html.escape(text)}</p>" for title, text in rows)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>longreach: alarm</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="stylesheet" href="../../static/style.css"></head><body class="help"><main>'
        f"<h1>{html.escape(kind.title)}</h1><p><code>{kind.code}</code>, priority {kind.level}</p>{body}"
        "<p>Acknowledging an alarm or resetting a fault never starts a motion.</p></main></body></html>"
    )


PAGE_CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
PAGE_HEADERS = {
    "Content-Security-Policy": PAGE_CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
StopPanel = Callable[[], Awaitable[None]]


class _UncachedStaticFiles(StaticFiles):
    """Our scripts and styles: never served from a cache, so that page and server are of one version."""

    def file_response(self, *args, **kwargs):  # starlette's own signature
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "no-cache"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


def install_panel(app: FastAPI, service: JobService) -> Callable[[FastAPI], Awaitable[StopPanel]]:
    """Add the routes; returns what starts feed and scene at the application's start and hands back how to stop them."""
    memory = PanelMemory(service)
    feed, scene = LiveFeed(memory), SceneFeed(service, memory)

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(STATIC_FOLDER / "index.html", headers=PAGE_HEADERS)

    app.include_router(live_router(memory, feed))
    app.include_router(video_router(service))
    app.include_router(hold_router(service, memory))
    app.include_router(panel_router(service, memory))
    app.include_router(recordings_router(service))
    app.include_router(scene_router(scene))
    app.mount("/static", _UncachedStaticFiles(directory=STATIC_FOLDER), name="static")

    async def start(running: FastAPI) -> StopPanel:
        running.state.viser_http = httpx.AsyncClient(
            timeout=10.0, trust_env=False
        )  # on this computer, never by a proxy
        tasks = SupervisedTasks()
        service.inner_faults.watch(SERVER_PART_FAILED_FAULT_ID, lambda: tasks.recent_failure)
        tasks.start("live-feed", feed.run)
        tasks.start("scene-feed", scene.run)

        async def stop() -> None:
            await tasks.close()
            await running.state.viser_http.aclose()

        return stop

    return start
