"""The index of findings: what a job left that others ask for by REST, plans by hash and calibrations by number."""

import json
import time
from dataclasses import asdict

from recording.clock import mono_ns
from server.calibration.calibration_life import LocalCalibration
from server.jobs.cell import Cell
from server.jobs.engine import Job, JobEvent
from server.jobs.keeper import Keeper
from server.jobs.knowledge import PreviewedPlan
from server.store.finding_rows import add_calibration, add_plan


class FindingLog:
    """Listener of the engine: at a job's end, what is new goes into the store."""

    def __init__(self, cell: Cell, keeper: Keeper) -> None:
        self._cell, self._keeper = cell, keeper
        self._known: LocalCalibration | None = cell.knowledge.life

    def note(self, job: Job, event: JobEvent) -> None:
        """Keep the previewed plan and the calibration that the ended job left."""
        if event.name != "ended":
            return
        if isinstance(job.result, PreviewedPlan):
            self._plan(job.job_id, job.result)
        life = self._cell.knowledge.life
        if life is not None and life is not self._known:
            self._known = life
            self._calibration(job.job_id)

    def _plan(self, job_id: str, previewed: PreviewedPlan) -> None:
        made_unix_s, now_ns = time.time(), mono_ns()
        expires_unix_s = made_unix_s + (previewed.expires_ns - now_ns) * 1e-9
        plan = previewed.plan
        view = json.dumps(
            {
                "length_mm": round(plan.length_m * 1e3, 1),
                "duration_s": round(plan.duration_s, 2),
                "predicted_sigma_mm": [round(value, 2) for value in previewed.predicted_sigma_mm],
                "q_goal_rad": [float(value) for value in previewed.q_goal],
            }
        )
        plan_hash = previewed.plan_hash
        self._keeper.later(lambda db: add_plan(db, plan_hash, job_id, made_unix_s, expires_unix_s, view))

    def _calibration(self, job_id: str) -> None:
        record = self._cell.knowledge.calibration
        if record is None:
            return
        made, view = time.time(), json.dumps(asdict(record))
        figures = (record.method, record.sigma_deg, record.residual_rms_mm)
        self._keeper.later(lambda db: add_calibration(db, made, job_id, *figures, view))
