"""Which commands must be held: on a real machine everything that a person moves."""

import hashlib
from pathlib import Path
from typing import Literal

from recording.files import read_text
from server.access.errors import AccessError
from server.access.lease import Lease, LeaseKind
from server.access.roles import Caller, Role
from server.commissioning.check_list import CHECK_LIST_STEPS
from server.commissioning.report import from_json, why_not_passed
from server.errors import SettingsError
from server.jobs.service import JobBody
from server.link.contracts import PlcSample

Mode = Literal["SIM", "REAL"]
MOTIONLESS_JOB_KINDS = frozenset({"look", "preview", "plan_identify"})
HOLD_TO_RUN_ONLY_JOB_KINDS = frozenset(
    {"jog"}
)  # not even a simulated machine, and not even a program: nothing else ends it


class HoldRequiredError(AccessError):
    """A click cannot move a real machine."""

    code = "hold_required"
    status = 409
    hint = "send the job over the WebSocket /v1/hold and keep answering its challenges; a fleet's key needs no hold"


class NotCommissionedError(AccessError):
    """A real machine without a passed commissioning does not jog."""

    code = "not_commissioned"
    status = 409
    hint = "pass every step of `longreach commission`, and set [jog] commissioning_report to its .json"


def mode_of(set_mode: Mode, latest: PlcSample | None) -> Mode:
    """SIM only where the settings say so and the PLC does not deny it.

    A click must never move steel by a line that was forgotten in a settings file.
    """
    return "REAL" if latest is not None and not latest.simulation else set_mode


def require_hold(mode: str, body: JobBody, lease: Lease, caller: Caller) -> None:
    """Whether this may move without being pressed over /v1/hold: a program may, under a fleet's lease; a jog never.

    A person's key is a person, whatever lease it found; without keys the lease alone says what it is.

    Raises: HoldRequiredError: a person's motion on a REAL machine; a jog.
    """
    if body.kind in HOLD_TO_RUN_ONLY_JOB_KINDS:
        raise HoldRequiredError(f"{body.kind} moves only while its button is held")
    person = caller.by_key and caller.role != Role.FLEET
    if mode == "REAL" and body.kind not in MOTIONLESS_JOB_KINDS and (person or lease.kind is not LeaseKind.FLEET):
        raise HoldRequiredError(f"{body.kind} moves a REAL machine: a person must hold the button while it moves")


def jog_refused(mode: Mode, not_commissioned: str) -> str:
    """Why this machine may not jog; empty when it may."""
    return (
        f"a REAL machine jogs after its commissioning only: {not_commissioned}"
        if mode == "REAL" and not_commissioned
        else ""
    )


def require_commissioned(mode: Mode, body: JobBody, not_commissioned: str) -> None:
    """Whether a jog may begin: on a REAL machine only with a passed commissioning; other jobs always.

    Raises: NotCommissionedError: why not.
    """
    refused = jog_refused(mode, not_commissioned) if body.kind == "jog" else ""
    if refused:
        raise NotCommissionedError(refused)


def why_not_commissioned(report_file: str | None, machine_text: str) -> str:
    """Why the report of the settings does not show that this machine is commissioned; empty when it does.

    Raises: SettingsError: the file cannot be read, or is not a report.
    """
    if report_file is None:
        return "[jog] commissioning_report is not set"
    try:
        text = read_text(Path(report_file))
    except OSError as error:
        raise SettingsError(
            f"[jog] commissioning_report {report_file}: {error.strerror}; give a report's .json"
        ) from error
    report = from_json(text, f"[jog] commissioning_report {report_file}")
    digest = hashlib.sha256(machine_text.encode()).hexdigest()
    return why_not_passed(report, [step.name for step in CHECK_LIST_STEPS], digest)
