"""Which commands must be held: on a real machine everything that an operator moves from the panel."""

from typing import Literal

from server.access.errors import AccessError
from server.access.lease import Lease, LeaseKind
from server.jobs.service import JobBody
from server.link.contracts import PlcSample

Mode = Literal["SIM", "REAL"]
STILL = frozenset({"look", "preview", "plan_experiment"})


class HoldRequiredError(AccessError):
    """A click cannot move a real machine."""

    code = "hold_required"
    status = 409
    hint = "send the job over the WebSocket /v1/hold and keep answering its challenges; a fleet's lease needs no hold"


def mode_of(set_mode: Mode, latest: PlcSample | None) -> Mode:
    """SIM only where the settings say so and the PLC does not deny it.

    A click must never move steel by a line that was forgotten in a settings file.
    """
    return "REAL" if latest is not None and not latest.simulation else set_mode


def require_hold(mode: str, body: JobBody, lease: Lease) -> None:
    """Raises: HoldRequiredError: an operator's motion on a REAL machine that was not pressed over /v1/hold."""
    if mode == "REAL" and lease.kind is LeaseKind.OPERATOR and body.kind not in STILL:
        raise HoldRequiredError(f"{body.kind} moves a REAL machine: the operator holds the button while it moves")
