"""An identification between its jobs: what is planned, what is driven already, and the diagnosis that follows."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from server.errors import JobFailedError
from server.jobs.diagnosing import Diagnoses
from server.jobs.engine import Job, JobState
from server.jobs.plans.identification_planning import LOOKS, Drive, PlannedIdentification
from server.jobs.plans.identifying import check_identification
from server.jobs.records import IdentificationDriven
from server.jobs.request_bodies import IdentifyRequest, PlanIdentifyRequest
from server.motion.identification_courses import PARTS

ALL_PARTS = (*(part.name for part in PARTS), LOOKS)


@dataclass(slots=True)
class Session:
    """One identification: several jobs where it was paused. `left`: parts still to be driven, of those possible."""

    drive: Drive
    planned: PlannedIdentification | None = None
    left: tuple[str, ...] = ()
    recordings: list[Path] = field(default_factory=list)
    diagnosis_id: str = ""
    ended: str = ""

    @property
    def done(self) -> list[str]:
        """Parts that were driven whole, in their order."""
        return [name for name in ALL_PARTS if name in self.drive.done]


class Identification:
    """Belongs to the event loop. Holds one session and one plan: it fires once."""

    def __init__(self, diagnoses: Diagnoses) -> None:
        self._diagnoses = diagnoses
        self.session: Session | None = None

    @property
    def next_step(self) -> str:
        """What there is to do; empty where nothing is."""
        session = self.session
        if session is None or session.planned is not None or session.diagnosis_id:
            return ""
        if not session.left:
            return "diagnose its recordings" if session.recordings else "plan it again"
        left = (
            f"{len(session.left)} of {len(session.left) + len(session.done)} parts remain ({', '.join(session.left)})"
        )
        ended = f" after '{session.ended}'" if session.ended else ""
        return f"paused{ended}: {left}; plan the rest with resume, or diagnose what is recorded"

    def drive_to_resume(self, body: PlanIdentifyRequest) -> Drive | None:
        """The drive of which the rest is to be planned; None where the request is for a new one.

        Raises: JobFailedError: there is none to resume.
        """
        if not body.resume:
            return None
        if self.session is None or not self.session.left:
            raise JobFailedError("no identification is paused: plan one without resume", "nothing_to_resume")
        return self.session.drive

    def keep_plan(self, drive: Drive, planned: PlannedIdentification) -> None:
        """Keep a plan until it fires, expires, or another one is made."""
        if self.session is None or self.session.drive is not drive:
            self.session = Session(drive)
        self.session.planned = planned
        self.session.left = tuple(part.name for part in planned.parts)

    def forget_plan(self) -> None:
        """No plan is kept; what was driven already is."""
        if self.session is not None:
            self.session.planned = None

    def require_fresh_plan(self, body: IdentifyRequest, t_now_ns: int) -> tuple[PlannedIdentification, Drive]:
        """The plan that is named, once. Raises: PlanRefusedError: another one, or too old."""
        session = self.session
        planned = check_identification(None if session is None else session.planned, body.plan_hash, t_now_ns)
        if session is None:  # never: it holds the plan
            raise JobFailedError("no identification was planned; send plan_identify first", "plan_refused")
        return planned, session.drive

    def after_drive(self, job: Job, recording: Path | None) -> None:
        """After a drive, whole or cut short: keep its recording, and diagnose all of them once nothing is left."""
        session = self.session
        if job.kind != "identify" or session is None:
            return
        session.planned = None  # a plan fires once
        session.left = tuple(name for name in session.left if name not in session.drive.done)
        session.ended = job.reason
        if recording is not None:
            session.recordings.append(recording)
        driven = job.result
        if job.state is not JobState.DONE or not isinstance(driven, IdentificationDriven):
            return
        if not session.recordings:
            job.result = replace(driven, not_followed="there is no recording of it")
            return
        following = self._diagnoses.queue_diagnosis(tuple(session.recordings), job.job_id)
        session.diagnosis_id = following.diagnosis_id
        job.result = replace(driven, followed_by=following.diagnosis_id)
