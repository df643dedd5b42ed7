"""The server's main process: the cell, the jobs and the API on one port."""

import asyncio
import gc
import logging
import signal
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from machine.chain import chain_of
from machine.description import parse_machine_toml
from server.access.gatekeeper import Gatekeeper
from server.access.hosts import is_loopback
from server.access.keys import KeyRing
from server.api.application import RestServices, create_application
from server.api.connection_limit import ACCEPTS_PER_TURN_MAX, LISTEN_BACKLOG, ExhaustionLog, PatientProtocol
from server.api.hold_rule import why_not_commissioned
from server.api.panel import install_panel
from server.api.state import why_not_ready
from server.api.state_view import result_data
from server.camera.client import VisionClient
from server.errors import SettingsError
from server.faces.foxglove import check_foxglove, foxglove_face
from server.faces.opcua import check_opcua, opcua_face
from server.inner_faults import SERVER_PART_FAILED_FAULT_ID
from server.jobs.calibration_store import CALIBRATION_FILE_NAME, CalibrationStore
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.jobs.keeper import Keeper
from server.jobs.performer import Performer
from server.jobs.service import JobService
from server.link.client import LinkClient
from server.recorder import Recorder
from server.service_manager import ServiceManager
from server.settings import HttpSettings, ServerSettings, read_machine_text
from server.settings_source import machine_text_with_camera, source_and_machine
from server.shell_settings import link_settings, vision_settings
from server.store.database import Database
from server.store.folder_lock import alone_in
from server.version import __version__
from server.warm_up import warmed_up

log = logging.getLogger(__name__)
DATABASE_NAME = "longreach.sqlite3"
# Control is kept alive every 5 s (a third of its time to live), and 5 s are also uvicorn's default: a renewal could
# meet a connection just closing. PatientProtocol ends an idle one after 10 to 20 s; this is the outer bound.
KEEP_ALIVE_S = 20
NUMERICS_LOADING_TEXT = (
    "the server is starting: it loads its numerics; where they are not compiled yet, this takes minutes"
)
JOB_END_TIMEOUT_S = 5.0  # longest wait for a running job's end before everything else is closed


def build_cell(settings: ServerSettings) -> Cell:
    """Everything for one machine, not yet started."""
    machine_text = read_machine_text(settings.machine_file)
    not_commissioned = why_not_commissioned(settings.jog.commissioning_report, machine_text)
    source, machine = source_and_machine(settings.camera, parse_machine_toml(machine_text))
    if settings.camera.calibration is not None:
        machine_text = machine_text_with_camera(machine_text, machine.camera)  # recordings say what their pictures were
    return Cell(
        settings=settings,
        machine=machine,
        chain=chain_of(machine),
        machine_text=machine_text,
        link=LinkClient(link_settings(settings), machine),
        vision=VisionClient(vision_settings(source, settings.camera, machine.camera), machine),
        recorder=Recorder(Path(settings.recording.folder), machine, images=settings.recording.images),
        not_commissioned=not_commissioned,
    )


def gatekeeper_of(http: HttpSettings) -> Gatekeeper:
    """Who may call. Raises: SettingsError: reachable from other computers without a key in force."""
    keys = KeyRing(Path(http.keys_file) if http.keys_file else None)
    if not is_loopback(http.host) and (keys.path is None or keys.has_no_valid_key):
        raise SettingsError(
            f"[http] host = '{http.host}' is reachable from other computers, and there is no key: make one with "
            "'longreach keys add NAME --role operator --file keys.json' and set [http] keys_file (or --keys), "
            "or listen on 127.0.0.1"
        )
    if http.behind_proxy and keys.path is None:
        raise SettingsError("[http] behind_proxy = true needs [http] keys_file: the proxy opens this port to others")
    return Gatekeeper(keys, http.allowed_hosts)


def build_app(settings: ServerSettings) -> FastAPI:
    """The ASGI application; link and vision processes live as long as it does."""
    gatekeeper = gatekeeper_of(settings.http)
    check_opcua(settings.opcua)
    check_foxglove(settings.foxglove)
    cell = build_cell(settings)
    folder = Path(settings.recording.folder)
    keeper = Keeper(Database(folder / DATABASE_NAME), result_data)
    keeper.database.open()
    performer = Performer(cell)
    engine = JobEngine(performer)
    keeper.on_restored(engine.restore)
    keeper.restore()
    service = JobService(cell, engine, CalibrationStore(folder / CALIBRATION_FILE_NAME), keeper)
    service.inner_faults.watch(
        SERVER_PART_FAILED_FAULT_ID, lambda: cell.link.listener_problem or cell.vision.listener_problem
    )

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        # OPC UA first: its address space is seconds of work, done before any sample waits for this loop.
        async with opcua_face(service, settings.opcua), foxglove_face(service, settings.foxglove), machine_side():
            yield
            gc.unfreeze()

    @asynccontextmanager
    async def machine_side() -> AsyncIterator[None]:
        cell.link.on_sample(cell.recorder.sample)
        cell.link.on_sample(performer.observe_plc_sample)
        cell.vision.on_report(cell.recorder.report)
        async with AsyncExitStack() as ending:  # in turn from the last one, whatever fails
            ending.push_async_callback(asyncio.to_thread, keeper.database.close)
            ending.push_async_callback(asyncio.to_thread, cell.recorder.finish)
            ending.push_async_callback(cell.vision.close)
            await cell.vision.start()  # first: it loads the longest, and does so in a process of its own
            ending.push_async_callback(cell.link.close)
            await cell.link.start()
            ending.push_async_callback(cancel_and_wait, asyncio.create_task(prepare_numerics(cell), name="prepare"))
            ending.push_async_callback(await install_panel_tasks(app))
            await ending.enter_async_context(running.tasks())
            ending.push_async_callback(engine.close)  # first of all: the lease guard is there as long as a job is
            yield

    app = FastAPI(
        title="longreach",
        version=__version__,
        lifespan=lifespan,
        openapi_url="/v1/openapi.json",
        docs_url=None,  # their pages load scripts from elsewhere
        redoc_url=None,
    )
    app.state.stop_motion = engine.close
    app.state.status = lambda: "; ".join(why_not_ready(service)) or "ready"
    running = create_application(
        app, RestServices(service, keeper, gatekeeper, secure_cookie=settings.http.behind_proxy)
    )
    install_panel_tasks = install_panel(app, service)
    return app


async def prepare_numerics(cell: Cell) -> None:
    """Numerics loaded, or compiled, while the panel already answers; until then no job begins."""
    cell.startup_note = NUMERICS_LOADING_TEXT
    try:
        await warmed_up(cell.machine, cell.chain)
    except Exception as error:  # without it a job would compile, or fail, during a motion
        log.exception("the numerics could not be prepared")
        cell.startup_note = f"the numerics could not be prepared ({error}); see the server's log, then start it again"
    else:
        cell.startup_note = ""
    gc.collect()
    gc.freeze()  # a quarter of a million things that stay: looking through them held every answer for 0.2 s


async def cancel_and_wait(task: asyncio.Task[None]) -> None:
    """Cancel the task and wait for it."""
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def serve(settings: ServerSettings, listening: Callable[[], None] = lambda: None) -> None:
    """Run until SIGINT or SIGTERM; a running job is stopped with a ramp first. `listening`: called once it does.

    Raises: SettingsError: another server holds the recordings folder.
    """
    with alone_in(Path(settings.recording.folder)):
        app = build_app(settings)
        manager = ServiceManager.of_environment(app.state.status)  # before any process is started
        asyncio.run(StoppingServer(config_of(app, settings.http), app, listening, manager).run_to_the_end())


class StoppingServer(uvicorn.Server):
    """Ends the motion first: uvicorn closes its port immediately, and then waits for readers for seconds.

    The application's lifespan is entered here, not by uvicorn, which would wait for the end of a start of minutes.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        app: FastAPI,
        listening: Callable[[], None] = lambda: None,
        manager: ServiceManager | None = None,
    ) -> None:
        super().__init__(config)
        self._app, self._listening = app, listening
        self._manager = manager or ServiceManager("", None, str)
        self._starting: asyncio.Task[None] | None = None
        self._alive: asyncio.Task[None] | None = None
        self._stop_motion: Callable[[], Awaitable[None]] = app.state.stop_motion

    async def run_to_the_end(self) -> None:
        """Start, serve, end; a signal during the start ends what has been started by then."""
        self._starting = asyncio.current_task()
        with self.capture_signals():
            try:
                async with self._app.router.lifespan_context(self._app):
                    self._starting = None
                    await self.serve()
                if self._alive is not None:  # to the end: recordings are closed while the watchdog still counts
                    await cancel_and_wait(self._alive)
            except asyncio.CancelledError:
                if not self.should_exit:
                    raise

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """As uvicorn's, but an end that was requested is not a failure: no signal is raised again."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self.handle_exit) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note that the end is wanted; twice by Ctrl-C: without waiting for readers."""
        super().handle_exit(sig, frame)
        starting, self._starting = self._starting, None  # once: what has been started is ended in peace
        if starting is not None:
            starting.get_loop().call_soon_threadsafe(starting.cancel)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, then say so; connections for which there is no descriptor fill no log."""
        asyncio.get_running_loop().set_exception_handler(ExhaustionLog())
        await super().startup(sockets)
        for server in self.servers:
            for listening in server.sockets:
                with listening.dup() as same:
                    same.listen(LISTEN_BACKLOG)
        if self.started:
            self._listening()
            self._manager.ready()
            self._alive = asyncio.create_task(self._manager.keep_alive(), name="service-manager")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """While the machine ramps down every caller is still answered."""
        self._manager.stopping()
        try:
            async with asyncio.timeout(JOB_END_TIMEOUT_S):
                await self._stop_motion()
        except Exception as error:  # the link process ends the motion, too, when it is closed
            log.warning("stop was not confirmed: %r; the PLC ramps by its own watchdog", error)
        await super().shutdown(sockets)


def config_of(app: FastAPI, http: HttpSettings) -> uvicorn.Config:
    """How it is served."""
    return uvicorn.Config(
        app,
        host=http.host,
        port=http.port,
        lifespan="off",  # see StoppingServer
        log_level="warning",
        access_log=False,  # its lines would hold lease ids
        http=PatientProtocol,
        backlog=ACCEPTS_PER_TURN_MAX,
        proxy_headers=http.behind_proxy,
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=3,
        ws_per_message_deflate=False,  # it took 4 ms a picture and viewer, in vain: JPEG does not get smaller
    )
