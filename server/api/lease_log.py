"""Control and the audit: fencing number and audit line are on disk together before the new holder gets an answer."""

import time

from fastapi import Request
from fastapi.responses import JSONResponse

from server.access.desk import LeaseDesk
from server.access.errors import AccessError, RoleError
from server.access.lease import Lease
from server.access.roles import Role
from server.api.callers import admission_of, caller_of, request_id_of
from server.api.lease_views import lease_view
from server.jobs.keeper import Keeper
from server.store.audit_rows import AuditEntry
from server.store.errors import StoreError

KINDS_OF_ROLE = {
    Role.OPERATOR: ("operator",),
    Role.FLEET: ("fleet",),
    Role.ENGINEER: ("operator", "engineer"),
    Role.ADMIN: ("operator", "engineer"),
}
WITHOUT_KEY = ("operator", "fleet")  # for users of this computer: a person, or one of their programs


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
        if kind not in (KINDS_OF_ROLE.get(Role(role), ()) if caller.by_key else WITHOUT_KEY):
            raise RoleError(f"role {role} may not hold control as {kind}", {"role": role, "kind": kind})
        if self._keeper is not None:
            self._keeper.check()

    async def given(self, request: Request, lease: Lease, action: str, detail: str = "") -> JSONResponse:
        """201 with the lease, once it is on disk.

        Raises: StoreError: it is not; the lease is withdrawn then.
        """
        self._desk.vouch(admission_of(request))
        if self._keeper is not None:
            try:
                await self._keeper.control(self._entry(request, lease, action, detail))
            except StoreError:
                self._withdraw(lease)
                raise
        headers = {"Cache-Control": "no-store"}
        return JSONResponse(lease_view(self._desk, lease).model_dump(), status_code=201, headers=headers)

    def note(self, request: Request, lease: Lease | None, action: str, detail: str = "") -> None:
        """A line about what happened already."""
        if self._keeper is not None and lease is not None:
            self._keeper.audit(self._entry(request, lease, action, detail))

    def _withdraw(self, lease: Lease) -> None:
        try:
            self._desk.release(lease.lease_id)
        except AccessError:
            return  # another client holds it by now

    def _entry(self, request: Request, lease: Lease, action: str, detail: str) -> AuditEntry:
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
