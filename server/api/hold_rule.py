"""Which commands must be held: on a real machine everything that a person moves."""

from typing import Literal

from server.access.errors import AccessError
from server.access.lease import Lease, LeaseKind
from server.access.roles import Caller, Role
from server.jobs.service import JobBody
from server.link.contracts import PlcSample

Mode = Literal["SIM", "REAL"]
STILL = frozenset({"look", "preview", "plan_identify"})


class HoldRequiredError(AccessError):
    """A click cannot move a real machine."""

    code = "hold_required"
    status = 409
    hint = "send the job over the WebSocket /v1/hold and keep answering its challenges; a fleet's key needs no hold"


def mode_of(set_mode: Mode, latest: PlcSample | None) -> Mode:
    """SIM only where the settings say so and the PLC does not deny it.

    A click must never move steel by a line that was forgotten in a settings file.
    """
    return "REAL" if latest is not None and not latest.simulation else set_mode


def require_hold(mode: str, body: JobBody, lease: Lease, caller: Caller) -> None:
    """Whether this may move without being pressed over /v1/hold: only a program may, under a fleet's lease.

    A person's key is a person, whatever lease it found; without keys the lease alone says what it is.

    Raises: HoldRequiredError: a person's motion on a REAL machine.
    """
    person = caller.by_key and caller.role != Role.FLEET
    if mode == "REAL" and body.kind not in STILL and (person or lease.kind is not LeaseKind.FLEET):
        raise HoldRequiredError(f"{body.kind} moves a REAL machine: a person must hold the button while it moves")
