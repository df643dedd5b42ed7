"""Control over REST: who has it, acquire, keep alive, release, take, ask, grant."""

import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, Path, Request
from fastapi.responses import JSONResponse, Response
from pydantic import Field

from server.access.desk import LEASE_TTL_S, LeaseDesk
from server.access.errors import AccessError, RoleError
from server.access.lease import Lease, LeaseKind
from server.access.roles import Role
from server.api.callers import admission_of, caller_of, request_id_of
from server.api.views import ControlView, Problem, Strict, View
from server.jobs.keeper import Keeper
from server.store.audit_rows import AuditEntry
from server.store.database import StoreError

# Control and the audit: fencing number and audit line are on disk together before the new holder gets an answer.

LEASE_KINDS_BY_ROLE = {
    Role.OPERATOR: ("operator",),
    Role.FLEET: ("fleet",),
    Role.ENGINEER: ("operator", "engineer"),
    Role.ADMIN: ("operator", "engineer"),
}
KEYLESS_LEASE_KINDS = ("operator", "fleet")  # for users of this computer: a person, or one of their programs


class ControlLog:
    """Writes what happens to control. Without a keeper nothing is written."""

    def __init__(self, desk: LeaseDesk, keeper: Keeper | None) -> None:
        self._desk, self._keeper = desk, keeper

    def check(self, request: Request, kind: str) -> None:
        """Whether this caller may have control of that kind now.

        Raises: RoleError: not with this role. StoreError: it could not be written down.
        """
        caller = caller_of(request)
        role = caller.role
        if kind not in (LEASE_KINDS_BY_ROLE.get(Role(role), ()) if caller.by_key else KEYLESS_LEASE_KINDS):
            raise RoleError(f"role {role} may not hold control as {kind}", {"role": role, "kind": kind})
        if self._keeper is not None:
            self._keeper.check()

    async def log_lease_given(self, request: Request, lease: Lease, action: str, detail: str = "") -> JSONResponse:
        """201 with the lease, once it is on disk. Raises: StoreError: it is not; the lease is withdrawn then."""
        self._desk.bind_lease_to_admission(admission_of(request))
        if self._keeper is not None:
            try:
                await self._keeper.control(self._lease_audit_entry(request, lease, action, detail))
            except StoreError:
                self._release_if_still_held(lease)
                raise
        headers = {"Cache-Control": "no-store"}
        return JSONResponse(lease_view(self._desk, lease).model_dump(), status_code=201, headers=headers)

    def log_note(self, request: Request, lease: Lease | None, action: str, detail: str = "") -> None:
        """A line about what happened already."""
        if self._keeper is not None and lease is not None:
            self._keeper.queue_audit_line(self._lease_audit_entry(request, lease, action, detail))

    def _release_if_still_held(self, lease: Lease) -> None:
        try:
            self._desk.release(lease.lease_id)
        except AccessError:
            return  # another client holds it by now

    def _lease_audit_entry(self, request: Request, lease: Lease, action: str, detail: str) -> AuditEntry:
        who = caller_of(request)
        return AuditEntry(
            t_unix_s=time.time(),
            who=who.name,
            role=who.role,
            address=who.address,
            action=action,
            lease_owner=lease.owner,
            fencing=lease.fencing,
            request_id=request_id_of(request),
            detail=detail,
        )


# Control as it is shown: to everybody without, to its holder with the secret.

Kind = Literal["operator", "fleet", "engineer"]


class LeaseView(View):
    """A lease as only its holder sees it: `lease_id` is the secret that commands carry."""

    lease_id: str
    fencing: int
    owner: str
    kind: Kind
    ttl_s: float
    expires_in_s: float


def control_view(desk: LeaseDesk) -> ControlView:
    """Who has control, for everybody."""
    held = desk.held
    if held is None:
        return ControlView(fencing=desk.book.fencing)
    offered = held.offered_to if held.is_offered_to(held.offered_to, desk.now_s) else ""
    return ControlView(
        owner=held.owner,
        kind=held.kind.value,
        fencing=held.fencing,
        expires_in_s=round(held.expires_in_s(desk.now_s), 1),
        stale=held.is_stale(desk.now_s),
        asked_by=list(held.asked_by),
        offered_to=offered,
    )


def lease_view(desk: LeaseDesk, lease: Lease) -> LeaseView:
    """For the holder's eyes only."""
    return LeaseView(
        lease_id=lease.lease_id,
        fencing=lease.fencing,
        owner=lease.owner,
        kind=lease.kind.value,
        ttl_s=lease.ttl_s,
        expires_in_s=round(lease.expires_in_s(desk.now_s), 1),
    )


Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
Ttl = Annotated[float, Field(ge=1.0, le=120.0, description="the lease goes stale when not renewed for this long")]
LeaseHeader = Annotated[str, Header(max_length=128, description="the lease_id of who has control")]
FencingHeader = Annotated[int, Header(ge=0, le=2**62, description="the fencing number of that lease")]
LeaseId = Annotated[str, Path(min_length=1, max_length=128, description="the secret that the holder received")]
REFUSED: dict[int | str, dict[str, Any]] = {
    403: {"model": Problem, "description": "no lease, or the caller may not take it"},
    409: {"model": Problem, "description": "another client has control; the answer states who and for how long"},
}
UNKEPT: dict[int | str, dict[str, Any]] = {503: {"model": Problem, "description": "cannot be stored; see /readyz"}}


class LeaseRequest(Strict):
    """Who wants control."""

    owner: Name
    kind: Kind = "operator"
    ttl_s: Ttl = LEASE_TTL_S


class TakeRequest(LeaseRequest):
    """A person takes control from the present holder."""

    reason: Annotated[str, Field(min_length=1, max_length=200)]


class AskRequest(Strict):
    """Who would like to have control."""

    owner: Name


class GrantRequest(Strict):
    """To whom the holder hands over."""

    to: Name


def lease_router(desk: LeaseDesk, keeper: Keeper | None = None) -> APIRouter:
    """Routes under /v1/lease. With a keeper, a new holder is on disk before the answer is sent."""
    router = APIRouter(prefix="/v1/lease", tags=["lease"])
    log = ControlLog(desk, keeper)

    @router.get("", response_model=ControlView)
    async def read_lease() -> ControlView:
        """Who has control; never the secret."""
        return control_view(desk)

    @router.post("", status_code=201, response_model=LeaseView, responses=REFUSED | UNKEPT)
    async def acquire(body: LeaseRequest, request: Request) -> JSONResponse:
        """Acquire free, stale or granted control; 409 names the holder and the time left."""
        log.check(request, body.kind)
        return await log.log_lease_given(
            request, desk.acquire(body.owner, LeaseKind(body.kind), body.ttl_s), "lease.acquire"
        )

    @router.post("/take", status_code=201, response_model=LeaseView, responses=REFUSED | UNKEPT)
    async def take(body: TakeRequest, request: Request) -> JSONResponse:
        """Take control as a person from any holder; the holder's running job is stopped with a ramp."""
        log.check(request, body.kind)
        lease = desk.take_control(body.owner, LeaseKind(body.kind), body.reason, body.ttl_s)
        return await log.log_lease_given(request, lease, "lease.take", body.reason)

    @router.post("/ask", response_model=ControlView)
    async def ask(body: AskRequest, request: Request) -> ControlView:
        """Request control from the holder."""
        log.log_note(request, desk.request_control(body.owner), "lease.ask", body.owner)
        return control_view(desk)

    @router.put("/{lease_id}", response_model=LeaseView, responses=REFUSED)
    async def keep_alive(lease_id: LeaseId, request: Request) -> LeaseView:
        """Renew a lease; also revives a stale one that no other client has acquired."""
        lease = desk.keep_alive(lease_id)
        desk.bind_lease_to_admission(admission_of(request))
        return lease_view(desk, lease)

    @router.delete("/{lease_id}", status_code=204, response_class=Response, responses=REFUSED)
    async def release(lease_id: LeaseId, request: Request) -> Response:
        """Give control back; a running job of this lease is stopped with a ramp."""
        log.log_note(request, desk.release(lease_id), "lease.release")
        return Response(status_code=204)

    @router.post("/{lease_id}/grant", response_model=ControlView, responses=REFUSED)
    async def grant(lease_id: LeaseId, body: GrantRequest, request: Request) -> ControlView:
        """Hand over: the named client may acquire within 30 s; until then the holder keeps control."""
        log.log_note(request, desk.offer_to(lease_id, body.to), "lease.grant", body.to)
        return control_view(desk)

    return router


def require_lease(desk: LeaseDesk) -> Callable[..., Lease]:
    """Dependency of every route that can move or arm: the lease that the request's headers name.

    Raises: NoLeaseError, LeaseLostError, LeaseStaleError.
    """

    async def lease(longreach_lease: LeaseHeader = "", longreach_fencing: FencingHeader = 0) -> Lease:
        return desk.check(longreach_lease, longreach_fencing)

    return lease  # pyright: ignore[reportReturnType] # FastAPI awaits it
