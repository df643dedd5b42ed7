"""An identification between its jobs: what is planned, what is driven already, and the diagnosis that follows."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from server.errors import JobFailedError
from server.jobs.diagnosing import Diagnoses
from server.jobs.engine import Job, JobState
from server.jobs.plans.identification_planning import LOOKS_PART_NAME, Drive, PlannedIdentification
from server.jobs.plans.identifying import check_identification
from server.jobs.records import IdentificationDriven
from server.jobs.request_bodies import IdentifyRequest, PlanIdentifyRequest
from server.motion.identification_courses import PARTS

IDENTIFICATION_PART_NAMES = (*(part.name for part in PARTS), LOOKS_PART_NAME)


@dataclass(slots=True)
class Session:
    """One identification: several jobs where it was paused. `remaining_parts`: of those possible."""

    drive: Drive
    planned_identification: PlannedIdentification | None = None
    remaining_parts: tuple[str, ...] = ()
    recordings: list[Path] = field(default_factory=list)
    diagnosis_id: str = ""
    end_reason: str = ""

    @property
    def done(self) -> list[str]:
        """Parts that were driven whole, in their order."""
        return [name for name in IDENTIFICATION_PART_NAMES if name in self.drive.done_parts]


class Identification:
    """Belongs to the event loop. Holds one session and one plan: it fires once."""

    def __init__(self, diagnoses: Diagnoses) -> None:
        self._diagnoses = diagnoses
        self.session: Session | None = None

    @property
    def next_step(self) -> str:
        """What there is to do; empty where nothing is."""
        session = self.session
        if session is None or session.planned_identification is not None or session.diagnosis_id:
            return ""
        if not session.remaining_parts:
            return "diagnose its recordings" if session.recordings else "plan it again"
        remaining = session.remaining_parts
        left = f"{len(remaining)} of {len(remaining) + len(session.done)} parts remain ({', '.join(remaining)})"
        ended = f" after '{session.end_reason}'" if session.end_reason else ""
        return f"paused{ended}: {left}; plan the rest with resume, or diagnose what is recorded"

    def drive_to_resume(self, body: PlanIdentifyRequest) -> Drive | None:
        """The drive of which the rest is to be planned; None where the request is for a new one.

        Raises: JobFailedError: there is none to resume.
        """
        if not body.resume:
            return None
        if self.session is None or not self.session.remaining_parts:
            raise JobFailedError("no identification is paused: plan one without resume", "nothing_to_resume")
        return self.session.drive

    def keep_plan(self, drive: Drive, planned: PlannedIdentification) -> None:
        """Keep a plan until it fires, expires, or another one is made."""
        if self.session is None or self.session.drive is not drive:
            self.session = Session(drive)
        self.session.planned_identification = planned
        self.session.remaining_parts = tuple(part.name for part in planned.parts)

    def forget_plan(self) -> None:
        """No plan is kept; what was driven already is."""
        if self.session is not None:
            self.session.planned_identification = None

    def require_fresh_plan(self, body: IdentifyRequest, t_now_ns: int) -> tuple[PlannedIdentification, Drive]:
        """The plan that is named, once. Raises: PlanRefusedError: another one, or too old."""
        session = self.session
        planned = check_identification(
            None if session is None else session.planned_identification, body.plan_hash, t_now_ns
        )
        if session is None:  # never: it holds the plan
            raise JobFailedError("no identification was planned; send plan_identify first", "plan_refused")
        return planned, session.drive

    def after_drive(self, job: Job, recording: Path | None) -> None:
        """After a drive, whole or cut short: keep its recording, and diagnose all of them once nothing is left."""
        session = self.session
        if job.kind != "identify" or session is None:
            return
        session.planned_identification = None  # a plan fires once
        session.remaining_parts = tuple(
            name for name in session.remaining_parts if name not in session.drive.done_parts
        )
        session.end_reason = job.reason
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
