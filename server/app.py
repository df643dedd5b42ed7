"""The server's main process: the cell, the jobs and the API on one port."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from machine.chain import chain_of
from machine.description import parse_machine_toml
from server.api.calibration import calibration_router
from server.api.jobs import jobs_router
from server.api.live import live_router
from server.api.panel import install_panel
from server.api.problems import install_problem_handlers
from server.api.state import state_router
from server.camera.client import VisionClient
from server.cell import Cell
from server.jobs.calibration_store import FILE_NAME, CalibrationStore
from server.jobs.engine import JobEngine
from server.jobs.journal import JobJournal
from server.jobs.performer import Performer
from server.jobs.service import JobService
from server.link.client import LinkClient
from server.recorder import Recorder
from server.settings import ServerSettings, read_machine_text
from server.settings_source import machine_text_with, source_and_machine
from server.shell_settings import link_settings, vision_settings
from server.version import __version__
from server.warm_up import warm_up


def build_cell(settings: ServerSettings) -> Cell:
    """Everything for one machine, not yet started."""
    machine_text = read_machine_text(settings.machine_file)
    source, machine = source_and_machine(settings.camera, parse_machine_toml(machine_text))
    if settings.camera.calibration is not None:
        machine_text = machine_text_with(machine_text, machine.camera)  # recordings say what their pictures were
    return Cell(
        settings=settings,
        machine=machine,
        chain=chain_of(machine),
        machine_text=machine_text,
        link=LinkClient(link_settings(settings), machine),
        vision=VisionClient(vision_settings(source), machine),
        recorder=Recorder(Path(settings.recording.folder), machine, images=settings.recording.images),
    )


def build_app(settings: ServerSettings) -> FastAPI:
    """The ASGI application; link and vision processes live as long as it does."""
    cell = build_cell(settings)
    journal = JobJournal(Path(settings.recording.folder) / "jobs.jsonl")
    engine = JobEngine(Performer(cell), journal.restore())
    engine.on_event(journal.note)
    service = JobService(cell, engine, CalibrationStore(Path(settings.recording.folder) / FILE_NAME))

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        cell.link.on_sample(cell.recorder.sample)
        cell.vision.on_report(cell.recorder.report)
        await cell.link.start()
        await cell.vision.start()
        await asyncio.to_thread(warm_up, cell.machine, cell.chain)
        panel = await install_panel_tasks(app)
        try:
            yield
        finally:
            await panel()
            await engine.close()
            await cell.vision.close()
            await cell.link.close()
            cell.recorder.stop()

    app = FastAPI(title="longreach", version=__version__, lifespan=lifespan)
    install_problem_handlers(app)
    app.include_router(state_router(service))
    app.include_router(jobs_router(service))
    app.include_router(live_router(service))
    app.include_router(calibration_router(service))
    install_panel_tasks = install_panel(app, service)
    return app


def serve(settings: ServerSettings) -> None:
    """Run until SIGINT or SIGTERM; a running job is stopped with a ramp first."""
    config = uvicorn.Config(
        build_app(settings),
        host=settings.http.host,
        port=settings.http.port,
        log_level="warning",
        timeout_graceful_shutdown=3,
    )
    asyncio.run(uvicorn.Server(config).serve())
