"""Experiments between their jobs: from a diagnosis to what is planned, from what was driven to the next diagnosis."""

from dataclasses import replace
from pathlib import Path

from server.api.views import ExperimentRequest, PlanExperimentRequest
from server.cell import Cell
from server.errors import JobFailedError, ServerError
from server.jobs.diagnosing import Diagnoses, Diagnosis
from server.jobs.engine import Job, JobState
from server.jobs.experiment_records import ExperimentDriven
from server.jobs.plans.experiment_planning import PlannedExperiment
from server.jobs.plans.experimenting import AskedExperiment, check_experiment
from server.jobs.proposals import proposal_of, separated_by


class Experiments:
    """Belongs to the event loop. Holds one plan: it fires once."""

    def __init__(self, diagnoses: Diagnoses) -> None:
        self._diagnoses = diagnoses
        self._planned: PlannedExperiment | None = None

    def asked(self, body: PlanExperimentRequest, cell: Cell) -> AskedExperiment:
        """What is to be planned.

        Raises: JobFailedError: no such diagnosis, no answer yet, nothing proposed, or nothing that can be driven.
        """
        one = self._answered(body.diagnosis_id)
        try:
            answer = self._diagnoses.result(one)
        except ServerError as error:
            raise JobFailedError(str(error), "no_answer") from error
        return AskedExperiment(
            diagnosis_id=one.diagnosis_id,
            proposal=proposal_of(answer, len(cell.machine.joints)),
            separates=separated_by(answer),
            recordings=one.recordings,
            machine_text=cell.machine_text,
            wall_free=body.wall_free,
            keep=body.keep,
        )

    def keep(self, planned: PlannedExperiment) -> None:
        """Keep a plan until it fires, expires, or another one is made."""
        self._planned = planned

    def forget(self) -> None:
        """No plan is kept."""
        self._planned = None

    def executable(self, body: ExperimentRequest, t_now_ns: int) -> PlannedExperiment:
        """The plan that is named, once.

        Raises: PlanRefusedError: another one, or too old. JobFailedError: its diagnosis is gone.
        """
        self._answered(body.diagnosis_id)
        return check_experiment(self._planned, body.diagnosis_id, body.plan_hash, t_now_ns)

    def follow(self, job: Job, recording: Path | None) -> None:
        """After an experiment was driven: diagnose its recording together with those of its diagnosis."""
        driven = job.result
        if job.kind == "experiment":
            self.forget()  # a plan fires once
        if not isinstance(driven, ExperimentDriven):
            return
        if job.state is not JobState.DONE or recording is None:
            job.result = replace(driven, not_followed="there is no recording of it")
            return
        first = self._diagnoses.find(driven.diagnosis_id)
        if first is None:
            job.result = replace(driven, not_followed=f"diagnosis {driven.diagnosis_id} is no longer known")
            return
        following = self._diagnoses.queue((*first.recordings, recording), job.job_id)
        job.result = replace(driven, followed_by=following.diagnosis_id)

    def _answered(self, diagnosis_id: str) -> Diagnosis:
        one = self._diagnoses.find(diagnosis_id)
        if one is None:
            raise JobFailedError(f"no diagnosis {diagnosis_id}; see GET /v1/diagnoses", "unknown_diagnosis")
        if one.state != "done":
            raise JobFailedError(f"diagnosis {diagnosis_id} is {one.state}; wait until it is done", "no_answer")
        return one
