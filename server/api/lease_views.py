"""Control as it is shown: to everybody without, to its holder with the secret."""

from typing import Literal

from server.access.desk import LeaseDesk
from server.access.lease import Lease
from server.api.views import ControlView, View

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
    offered = held.offered_to if held.offered(held.offered_to, desk.now_s) else ""
    return ControlView(
        owner=held.owner,
        kind=held.kind.value,
        fencing=held.fencing,
        expires_in_s=round(held.expires_in_s(desk.now_s), 1),
        stale=held.stale(desk.now_s),
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
