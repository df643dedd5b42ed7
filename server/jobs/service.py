"""From a request to a plan: the one place that knows which plan serves which kind of job."""

import asyncio
import logging
import time
from collections.abc import Callable, Generator
from pathlib import Path

from recording.clock import SUSPENDED_REASON, SuspendWatch, mono_ns, mono_s
from server.access.lease import Lease
from server.compensation.compensation import CompensationError
from server.compensation.reading import compensation_from
from server.compensation.versions import MachineVersions
from server.disk_space import DiskSpace
from server.errors import BusyError, JobFailedError
from server.inner_faults import InnerFaults
from server.jobs.calibration_store import CalibrationStore, machine_id_of
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.diagnosing import Diagnoses
from server.jobs.engine import Job, JobEngine, JobEvent
from server.jobs.identification import Identification
from server.jobs.keeper import SERVER_COMMAND, Command, FindingLog, Keeper, job_start_rows
from server.jobs.knowledge import LookTaken, PreviewedPlan
from server.jobs.plans.calibrating import calibrate
from server.jobs.plans.identifying import drive_identification, plan_identification
from server.jobs.plans.jogging import jog
from server.jobs.plans.line import line_run
from server.jobs.plans.looking import take_look
from server.jobs.plans.moving import check_executable, execute, preview
from server.jobs.plans.orienting import orient
from server.jobs.plans.pattern import marks_of, visit_marks
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import park, retract, return_to_start
from server.jobs.plans.servoing import servo
from server.jobs.plans.unmoved import moved_since_look
from server.jobs.request_bodies import (
    CalibrateRequest,
    ExecuteRequest,
    IdentifyRequest,
    JogRequest,
    LineRequest,
    LookRequest,
    OrientRequest,
    ParkRequest,
    PatternRequest,
    PlanIdentifyRequest,
    PositionRequest,
    PreviewRequest,
    RetractRequest,
    ReturnRequest,
    ServoRequest,
)
from server.jobs.requests import Plan, Progress, Request
from server.link.errors import LinkError

log = logging.getLogger(__name__)
RESUME_CHECK_PERIOD_S = 0.1

JobBody = (
    LookRequest
    | OrientRequest
    | CalibrateRequest
    | PreviewRequest
    | ExecuteRequest
    | PositionRequest
    | PatternRequest
    | LineRequest
    | ServoRequest
    | PlanIdentifyRequest
    | IdentifyRequest
    | RetractRequest
    | JogRequest
    | ReturnRequest
    | ParkRequest
)


class JobService:
    """Starts jobs for the API and follows them with a recording."""

    def __init__(
        self, cell: Cell, engine: JobEngine, store: CalibrationStore | None = None, keeper: Keeper | None = None
    ) -> None:
        self.cell = cell
        self.keeper = keeper
        self.engine = engine
        self.inner_faults = InnerFaults()
        self.disk = DiskSpace(Path(cell.settings.recording.folder))
        self.alarm_codes: Callable[[], frozenset[str]] = (
            frozenset  # of the alarms whose cause is there; the panel's book
        )
        self._store = store or CalibrationStore(None)
        self._settings_json = cell.settings.model_dump_json()
        folder = Path(cell.settings.recording.folder)
        self.versions = MachineVersions(folder / "machine-versions", cell.machine, cell.machine_text)
        self._by_settings = compensation_from(cell.settings, cell.machine)
        self.context = self._context()
        self.diagnoses = Diagnoses(Path(cell.settings.recording.folder))
        self.identification = Identification(self.diagnoses)
        self._suspend, self._resumed, self._resumed_mono_s = SuspendWatch(), False, float("-inf")
        engine.interruption = self._suspension_text
        cell.knowledge.unix_minus_mono_s = time.time() - mono_s()
        expiry = cell.settings.calibration.expiry()
        self._store.restore(cell.knowledge, self.context.machine_id, cell.chain.n, time.time(), expiry)
        engine.on_event(self._record_job_event)
        if keeper is not None:
            engine.on_event(keeper.on_job_event)
            engine.on_event(FindingLog(cell, keeper).on_job_event)

    def _context(self) -> PlanContext:
        """What plans are given: with what the settings name, else with the version in use."""
        cell, known = self.cell, self._by_settings
        version = None if known is not None else self.versions.in_use
        known = known or self.versions.compensation()
        machine_id = machine_id_of(cell.machine_text, () if known is None else known.effects_by_use.compensated)
        version_id = "" if version is None else version.version_id
        return PlanContext(
            cell.machine,
            cell.chain,
            cell.settings,
            cell.knowledge,
            machine_id=machine_id,
            compensation=known,
            version_id=version_id,
        )

    async def use_version(self, version_id: str, on: tuple[bool, ...] | None) -> None:
        """Use a version of this machine, or none; what was learnt with another one is forgotten.

        Raises: BusyError: a job runs. CompensationError: not of this machine, or the settings name a file.
        """
        if self._by_settings is not None:
            raise CompensationError(
                "[compensation] machine_file in the settings is in use; take it out of them and start the server again"
            )
        running = self.engine.current
        if running is not None and not running.has_ended:
            raise BusyError(f"job {running.job_id} ({running.kind}) is running; wait for its end or stop it", {})
        if version_id:
            self.versions.require_this_machine(version_id)
            if on is not None:
                self.versions.switch_effects(version_id, on)
        self.versions.use_version(version_id)
        self.context = self._context()
        self.cell.knowledge.forget_calibration()
        self.cell.knowledge.forget_sight()
        self.cell.knowledge.stall_rad = None

    @property
    def store_problem(self) -> str:
        """Why nothing can be written down now, and so no job may begin; empty when all is well."""
        return self.keeper.why_not_storing if self.keeper is not None else ""

    @property
    def recording_problem(self) -> str:
        """Why not all of the running job, or else of the last one, is written down; empty while it is."""
        problem = self.cell.recorder.why_not_recording
        return self.engine.not_noted or (problem if isinstance(problem, str) else "")

    async def start(self, body: JobBody, lease: Lease | None = None, command: Command = SERVER_COMMAND) -> Job:
        """Check what can be checked now, write the job down, then start it under `engine.leases.check`'s lease.

        Raises: BusyError, PlanRefusedError, JobFailedError, StoreError when it may not start; nothing moves then.
        """
        self._note_resume()
        if self.cell.startup_note:
            raise JobFailedError(self.cell.startup_note, "starting")
        plan = self._plan(body)
        owner = body.owner or (lease.owner if lease else "server")
        plan_hash = getattr(body, "plan_hash", "")

        async def keep(job: Job) -> None:
            if self.keeper is not None:
                await self.keeper.begin(job_start_rows(job, body.model_dump_json(), plan_hash, lease, command))

        return await self.engine.submit_kept(body.kind, plan, owner, lease, keep)

    async def watch_suspend(self) -> None:
        """Until cancelled: after a resume the running job is stopped."""
        while True:
            await asyncio.sleep(RESUME_CHECK_PERIOD_S)
            self._note_resume()
            if self._resumed:
                self._resumed = False
                try:
                    await self.engine.stop(SUSPENDED_REASON)
                except LinkError as error:
                    log.warning("stop was not confirmed: %s; the PLC ramps by its own watchdog", error)

    def _note_resume(self) -> None:
        """At a resume, before anything else: what was known, planned and granted before it ends.

        Link and vision process watch for themselves: each ends and is started again, which disarms the machine and
        leaves no picture of before in a buffer.
        """
        if self._suspend.was_suspended():
            log.warning(SUSPENDED_REASON)
            self._resumed, self._resumed_mono_s = True, mono_s()
            self.cell.knowledge.forget_sight()
            self.identification.forget_plan()
            self.engine.leases.revoke(SUSPENDED_REASON)

    def _suspension_text(self, job: Job) -> str:
        """That the PC was suspended while the job ran, whether the silent PLC was noticed before or after it."""
        self._note_resume()
        return SUSPENDED_REASON if self._resumed_mono_s >= job.started_mono_s else ""

    def _plan(self, body: JobBody) -> Plan:
        ctx = self.context
        match body:
            case LookRequest():
                return take_look(ctx)
            case OrientRequest():
                return orient(ctx, self._last_look())
            case CalibrateRequest():
                return calibrate(ctx, self._last_look())
            case PreviewRequest():
                return _preview_motion(ctx, self._last_look())
            case ExecuteRequest():
                previewed = check_executable(ctx.knowledge.previewed_plan, body.plan_hash, mono_ns())
                return execute(ctx, previewed, 1 + sum(move.kind == "move" for move in ctx.knowledge.moves))
            case PositionRequest():
                return position(ctx.with_method(body.method), body.recalibrate)
            case PatternRequest():
                return visit_marks(ctx, marks_of(ctx, body.target_ids))
            case LineRequest():
                return line_run(ctx.with_method("paper"), body.variant)
            case ServoRequest():
                return servo(ctx)
            case PlanIdentifyRequest():
                desk = self.identification
                return plan_identification(
                    ctx, body.minutes, body.wall_free, desk.drive_to_resume(body), desk.keep_plan
                )
            case IdentifyRequest():
                return drive_identification(ctx, *self.identification.require_fresh_plan(body, mono_ns()))
            case RetractRequest():
                return retract(ctx, body.distance_mm)
            case JogRequest():
                return jog(ctx, body.axis, body.direction)
            case ReturnRequest():
                return return_to_start(ctx)
            case ParkRequest():
                if not (ctx.knowledge.has_looked_for_wall or body.wall_free):
                    raise JobFailedError(
                        "no wall is known, so the clearance while folding cannot be checked: look first, or park with "
                        "wall_free = true if there is none within reach",
                        "no_wall",
                    )
                return park(ctx)

    def _last_look(self) -> LookTaken:
        """The last look, if it may still be acted upon: never move on a stale look."""
        taken, limit_s = self.cell.knowledge.last_look, self.cell.settings.look.age_max_s
        if taken is None or taken.error is None:
            raise JobFailedError("there is no valid look yet; look first", "no_look")
        age_s = (mono_ns() - taken.record.t_mono_ns) * 1e-9
        if age_s > limit_s:
            raise JobFailedError(
                f"the last look is {age_s:.0f} s old (limit {limit_s:.0f} s); look again", "stale_look"
            )
        latest = self.cell.link.latest
        moved = moved_since_look(self.cell.machine, latest.q_rad, taken.reading.q_rad) if latest else ""
        if moved:
            raise JobFailedError(moved, "stale_look")
        return taken

    def _record_job_event(self, job: Job, event: JobEvent) -> None:
        recorder = self.cell.recorder
        if event.name == "started":
            recorder.start(f"{job.kind}-{job.job_id}", self._settings_json, self.cell.machine_text)
        recorder.log_event("info" if job.code == "" else "error", event.text)
        if event.name == "ended":
            self._store.save_if_changed(self.cell.knowledge)
            recorder.result(job.result if job.result is not None else job.reason)
            recording = recorder.stop()
            self.identification.after_drive(job, recording)


def _preview_motion(ctx: PlanContext, taken: LookTaken) -> Generator[Request, object, PreviewedPlan]:
    previewed = preview(ctx, taken, mono_ns())
    text = f"{previewed.plan.length_m * 1e3:.0f} mm in {previewed.plan.duration_s:.1f} s, plan {previewed.plan_hash}"
    yield Progress("preview", 1.0, 1.0, "", text)
    return previewed
