"""The panel on the API's port: our page at /, its files at /static, and everything that feeds it."""

from collections.abc import Awaitable, Callable

import httpx
from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from server.api.hold import hold_router
from server.api.live import LiveFeed, live_router
from server.api.panel_memory import PanelMemory
from server.api.panel_recordings import recordings_router
from server.api.panel_routes import panel_router
from server.api.panel_scene import SceneFeed, scene_router
from server.api.video import video_router
from server.inner_faults import PART_FAILED
from server.jobs.service import JobService
from server.supervised_tasks import SupervisedTasks
from web import STATIC_FOLDER

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


class _Static(StaticFiles):
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
    app.mount("/static", _Static(directory=STATIC_FOLDER), name="static")

    async def start(running: FastAPI) -> StopPanel:
        running.state.viser_http = httpx.AsyncClient(
            timeout=10.0, trust_env=False
        )  # on this computer, never by a proxy
        tasks = SupervisedTasks()
        service.inner_faults.watch(PART_FAILED, lambda: tasks.problem)
        tasks.start("live-feed", feed.run)
        tasks.start("scene-feed", scene.run)

        async def stop() -> None:
            await tasks.close()
            await running.state.viser_http.aclose()

        return stop

    return start
