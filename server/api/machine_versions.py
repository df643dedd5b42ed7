"""What identifications found of this machine: kept by version, used or not, effect by effect, and what it changed."""

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Depends
from fastapi import Path as InPath
from fastapi.responses import JSONResponse, PlainTextResponse, Response
from pydantic import Field

from server.api.lease import require_lease
from server.api.problems import problem_response
from server.api.views import Problem, Strict, View
from server.compensation.compensation import CompensationError
from server.compensation.versions import FoundEffect, MachineVersion
from server.errors import ServerError
from server.jobs.identification import Identification
from server.jobs.service import JobService

Id = Annotated[str, InPath(pattern=r"^[0-9a-f]{12}$")]
UNKNOWN: dict[int | str, dict[str, Any]] = {404: {"model": Problem}}
REFUSED: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (403, 404, 409)}


class NewVersion(Strict):
    """Of which diagnosis."""

    diagnosis_id: Annotated[str, Field(pattern=r"^[0-9a-f]{12}$")]


class InUse(Strict):
    """Which version the server uses from now on; empty: none. `on`: each of its effects, in order; absent: as kept."""

    version_id: Annotated[str, Field(pattern=r"^([0-9a-f]{12})?$")]
    on: list[bool] | None = Field(default=None, max_length=200)


class FoundEffectView(View):
    """One effect. `does`: what the server changes by it; empty: only a simulation uses it."""

    name: str
    joint: int | None
    parameters: dict[str, float | str | list[float]]
    tool_mm: float
    probability: float
    does: str
    on: bool


class VersionView(View):
    """What one identification found."""

    version_id: str
    made_unix_s: float
    machine: str
    serial: str
    recordings: list[str]
    diagnosis_id: str
    sentence: str
    miss_mm: float | None
    left_mm: float | None
    effects: list[FoundEffectView]


class ComparedView(View):
    """One executed move: how far a move by kinematics alone would have missed, by the machine file and as in use."""

    number: int
    nominal_mm: float
    in_use_mm: float | None
    version_id: str


class VersionsView(View):
    """All versions, newest first, the one in use, and what the moves since the server's start say of it."""

    in_use: str
    problem: str
    versions: list[VersionView]
    compared: list[ComparedView]


def machine_router(service: JobService) -> APIRouter:
    """Routes under /v1/machine."""
    router = APIRouter(prefix="/v1/machine", tags=["machine"])
    control = require_lease(service.engine.leases)

    @router.get("/versions", response_model=VersionsView)
    async def list_versions() -> VersionsView:
        """Every version of this machine, and which one is in use."""
        return await asyncio.to_thread(_versions_view, service)

    @router.post("/versions", status_code=201, response_model=VersionView, responses=REFUSED)
    async def make_version(body: NewVersion) -> JSONResponse:
        """Save the effects found by a finished diagnosis, confirmed and likely, as a version, without using it."""
        one = service.diagnoses.find_diagnosis(body.diagnosis_id)
        if one is None:
            return problem_response(404, "Unknown diagnosis", f"no diagnosis {body.diagnosis_id}", "unknown_diagnosis")
        try:
            answer = await asyncio.to_thread(service.diagnoses.result, one)
            version = await asyncio.to_thread(service.versions.make_version, answer, one.diagnosis_id)
        except (ServerError, CompensationError) as error:
            return problem_response(409, "No version", str(error), "no_version", "see GET /v1/diagnoses")
        return JSONResponse(_version_view(version).model_dump(mode="json"), status_code=201)

    @router.put("/in-use", response_model=VersionsView, dependencies=[Depends(control)], responses=REFUSED)
    async def use_version(body: InUse) -> VersionsView | JSONResponse:
        """Use a version, or none: plans and calibrations start from it; an older calibration is forgotten."""
        try:
            await service.use_version(body.version_id, None if body.on is None else tuple(body.on))
        except CompensationError as error:
            return problem_response(
                409, "Version not used", str(error), "version_refused", "see GET /v1/machine/versions"
            )
        return await asyncio.to_thread(_versions_view, service)

    @router.get(
        "/versions/{version_id}/file",
        response_model=None,
        response_class=PlainTextResponse,
        responses=UNKNOWN | {200: {"content": {"application/toml": {"schema": {"type": "string"}}}}},
    )
    async def version_file(version_id: Id) -> Response:
        """The machine file with the version's effects, for `longreach sim --machine` and `longreach compare`."""
        version = await asyncio.to_thread(service.versions.find_version, version_id)
        if version is None:
            return problem_response(404, "Unknown version", f"no version {version_id}", "unknown_version")
        text = await asyncio.to_thread(service.versions.machine_file, version)
        name = f"{version.machine}-{version.version_id}.toml"
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        return PlainTextResponse(text, media_type="application/toml", headers=headers)

    return router


def _versions_view(service: JobService) -> VersionsView:
    used = service.versions.in_use
    return VersionsView(
        in_use="" if used is None else used.version_id,
        problem=service.versions.problem,
        versions=[_version_view(version) for version in service.versions.list_versions()],
        compared=[
            ComparedView(
                number=comparison.number,
                nominal_mm=comparison.nominal_mm,
                in_use_mm=comparison.in_use_mm,
                version_id=comparison.version_id,
            )
            for comparison in service.cell.knowledge.compared_moves
        ],
    )


def _version_view(version: MachineVersion) -> VersionView:
    return VersionView(
        version_id=version.version_id,
        made_unix_s=version.made_unix_s,
        machine=version.machine,
        serial=version.serial,
        recordings=list(version.recordings),
        diagnosis_id=version.diagnosis_id,
        sentence=version.sentence,
        miss_mm=version.miss_mm,
        left_mm=version.left_mm,
        effects=[_effect_view(effect) for effect in version.effects],
    )


def _effect_view(one: FoundEffect) -> FoundEffectView:
    parameters: dict[str, float | str | list[float]] = dict(one.entry.values)
    if one.entry.option:
        parameters["option"] = one.entry.option
    if one.entry.direction:
        parameters["direction"] = list(one.entry.direction)
    return FoundEffectView(
        name=one.entry.name,
        joint=one.entry.joint,
        parameters=parameters,
        tool_mm=round(one.tool_mm, 3),
        probability=one.probability,
        does=one.does,
        on=one.on,
    )


# How far an identification is, over REST: what is driven, what is left, and what to do next.


class IdentificationView(View):
    """The identification of this life of the server. `next_step`: empty where there is nothing to do."""

    parts_done: list[str]
    parts_left: list[str]
    recordings: list[str]
    diagnosis_id: str
    next_step: str


def identification_router(identification: Identification) -> APIRouter:
    """Route /v1/identification."""
    router = APIRouter(prefix="/v1/identification", tags=["machine"])

    @router.get("", response_model=IdentificationView)
    async def read_identification() -> IdentificationView:
        """Completed and remaining parts of the last identification."""
        session = identification.session
        return IdentificationView(
            parts_done=[] if session is None else session.done,
            parts_left=[] if session is None else list(session.remaining_parts),
            recordings=[] if session is None else [path.name for path in session.recordings],
            diagnosis_id="" if session is None else session.diagnosis_id,
            next_step=identification.next_step,
        )

    return router
