"""All of REST on one application: guard, routes, errors, document. Used by the server and by its tests."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from recording.clock import mono_s
from server.access.gatekeeper import Gatekeeper
from server.api.calibration import calibration_router
from server.api.diagnoses import diagnoses_router
from server.api.events import EventFeed, EventLog, events_router
from server.api.findings import LookLog, findings_router
from server.api.guard import Guard
from server.api.jobs import jobs_router
from server.api.lease import lease_router
from server.api.machine_versions import identification_router, machine_router
from server.api.metrics import metrics_router
from server.api.openapi import install_openapi
from server.api.oversight import oversight_router
from server.api.problems import install_problem_handlers
from server.api.runs import runs_router
from server.api.session import session_router
from server.api.state import StateCache, state_router, straight_route
from server.api.targets import target_router
from server.inner_faults import KEYS_UNREADABLE_FAULT_ID, SERVER_PART_FAILED_FAULT_ID
from server.jobs.diagnosing import Diagnoses
from server.jobs.keeper import Keeper
from server.jobs.lease_guard import guard_lease, stop_unguarded
from server.jobs.service import JobService
from server.supervised_tasks import SupervisedTasks

# HEAD wherever there is GET, as load balancers and monitors ask: the same status and headers, without the body.


class HeadRequestMiddleware:
    """ASGI middleware: a HEAD is worked on as the GET would be, until its headers are there."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return await self._app(scope, receive, send)
        begun = asyncio.Event()

        async def headers_only(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                begun.set()

        async with asyncio.TaskGroup() as tasks:
            answering = tasks.create_task(self._answer({**scope, "method": "GET"}, receive, headers_only))
            waiting = tasks.create_task(begun.wait())
            await asyncio.wait({answering, waiting}, return_when=asyncio.FIRST_COMPLETED)
            for task in (answering, waiting):  # a stream of events would go on without end
                task.cancel()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._app(scope, receive, send)


@dataclass(frozen=True, slots=True)
class RestServices:
    """What REST serves, and to whom."""

    job_service: JobService
    keeper: Keeper
    gatekeeper: Gatekeeper
    secure_cookie: bool


@dataclass(frozen=True, slots=True)
class ServerTasks:
    """What runs alongside the requests."""

    rest_services: RestServices
    event_feed: EventFeed
    diagnoses: Diagnoses

    @asynccontextmanager
    async def tasks(self) -> AsyncIterator[None]:
        """Event feed, lease guard and store watch, for as long as the application lives."""
        service, running = self.rest_services.job_service, SupervisedTasks()
        service.inner_faults.watch(SERVER_PART_FAILED_FAULT_ID, lambda: running.recent_failure)
        running.start("event-feed", self.event_feed.run)
        running.start("lease-guard", lambda: guard_lease(service.engine), lambda: stop_unguarded(service.engine))
        running.start("suspend-watch", service.watch_suspend)
        running.start("store-watch", self.rest_services.keeper.watch)
        try:
            yield
        finally:
            await running.close()
            await self.diagnoses.close()


def create_application(app: FastAPI, served: RestServices) -> ServerTasks:
    """Add everything; what it returns runs in the application's lifespan."""
    service, keys = served.job_service, served.gatekeeper.keys

    def keys_problem() -> str:
        keys.refresh(mono_s())  # /readyz reports the present state also while no client presents a key
        return keys.why_no_key_valid

    service.inner_faults.watch(KEYS_UNREADABLE_FAULT_ID, keys_problem)
    folder = Path(service.cell.settings.recording.folder)
    log, cache, diagnoses = EventLog(uuid4().hex[:8]), StateCache(service), service.diagnoses
    app.add_middleware(HeadRequestMiddleware)
    app.add_middleware(Guard, gatekeeper=served.gatekeeper)
    install_problem_handlers(app)
    for router in (
        state_router(service, cache),
        events_router(log),
        lease_router(service.engine.leases, served.keeper),
        jobs_router(service),
        findings_router(service, LookLog(service)),
        calibration_router(service),
        runs_router(folder),
        diagnoses_router(folder, diagnoses),
        identification_router(service.identification),
        machine_router(service),
        oversight_router(service, log.life),
        target_router(service),
        session_router(served.gatekeeper, secure=served.secure_cookie),
        metrics_router(service, lambda: log.readers),
    ):
        app.include_router(router)
    app.router.routes.insert(0, straight_route(cache))
    install_openapi(app)
    return ServerTasks(served, EventFeed(service, log, cache), diagnoses)
