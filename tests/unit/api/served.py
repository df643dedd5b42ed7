"""A served application with a stand-in machine, as the server builds it: guard, store and all. No process."""

import asyncio
import time
from dataclasses import dataclass

import httpx
import numpy as np
from fastapi import FastAPI
from test_api_routes import MACHINE, StandInLink, StandInPerformer, StandInRecorder, StandInVision

from machine.chain import chain_of
from server.access.gatekeeper import Gatekeeper
from server.access.keys import KeyRing, new_key, with_key, write_keys
from server.access.roles import Role
from server.api.application import RestServices, ServerTasks, create_application
from server.api.panel import install_panel
from server.errors import JobFailedError
from server.jobs.cell import Cell
from server.jobs.engine import JobEngine
from server.jobs.keeper import Keeper
from server.jobs.service import JobService
from server.settings import RecordingSettings, ServerSettings
from server.store.database import Database

HOST = "127.0.0.1:8080"


class Link(StandInLink):
    async def disarm(self):
        pass

    async def reset(self):
        pass


class Performer(StandInPerformer):
    """Notes what it was asked for and fails: there is no machine. `hold` makes it wait before."""

    def __init__(self, link):
        super().__init__(link)
        self.hold = None
        self.performed = []

    async def perform(self, request):
        self.performed.append(type(request).__name__)
        if self.hold is not None:
            await self.hold.wait()
        raise JobFailedError("there is no machine", "stand_in")


@dataclass
class Bench:
    """What a test needs of it."""

    app: FastAPI
    running: ServerTasks
    service: JobService
    keeper: Keeper
    performer: Performer
    gatekeeper: Gatekeeper
    keys: dict[str, str]

    def client(self, role: str = "", **headers: str) -> httpx.AsyncClient:
        """A program's client, with the key of that role."""
        if role:
            headers["Authorization"] = f"Bearer {self.keys[role]}"
        transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
        return httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}", headers=headers)

    def control(self, owner: str = "test") -> dict[str, str]:
        """Headers of one who has control."""
        lease = self.service.engine.leases.acquire(owner, ttl_s=60.0)
        return {"Longreach-Lease": lease.lease_id, "Longreach-Fencing": str(lease.fencing)}

    async def settled(self) -> None:
        """Until no job runs."""
        if self.service.engine._task is not None:
            await asyncio.wait({self.service.engine._task}, timeout=5.0)


def bench(folder, keyed: bool = False) -> Bench:
    """Built on a folder; with keys of every role, or open on loopback."""
    settings = ServerSettings(recording=RecordingSettings(folder=str(folder / "runs")))
    (folder / "runs").mkdir(exist_ok=True)
    link = Link()
    cell = Cell(settings, MACHINE, chain_of(MACHINE), "", link, StandInVision(), StandInRecorder())
    cell.knowledge.T_base_ooi = np.eye(4)  # a wall is known: jobs that move are admitted
    performer = Performer(link)
    keeper = Keeper(Database(folder / "runs" / "longreach.sqlite3"), lambda result: result)
    keeper.database.open()
    engine = JobEngine(performer)
    keeper.on_restored(engine.restore)
    keeper.restore()
    service = JobService(cell, engine, keeper=keeper)
    keys, file = _keys(folder) if keyed else ({}, None)
    gatekeeper = Gatekeeper(KeyRing(file))
    app = FastAPI(openapi_url="/v1/openapi.json")
    running = create_application(app, RestServices(service, keeper, gatekeeper, secure_cookie=False))
    install_panel(app, service)  # its routes are in the document too; its feeds are not started
    return Bench(app, running, service, keeper, performer, gatekeeper, keys)


def _keys(folder):
    secrets, kept = {}, ()
    for role in Role:
        secrets[role.value] = new_key()
        kept = with_key(kept, f"{role.value} 1", role, secrets[role.value], time.time())
    file = folder / "keys.json"
    write_keys(file, kept)
    return secrets, file
