"""Choosing the object of interest: measured first, accepted then; what was seen of the former one is forgotten."""

import asyncio
from collections.abc import Callable

import numpy as np

from recording.clock import mono_ns
from server.camera.client import VisionClient
from server.camera.contracts import MarksFound
from server.errors import BusyError, JobFailedError
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.engine import JobEngine
from server.jobs.knowledge import Knowledge
from server.jobs.performer import SILENT_S
from server.jobs.plans.reach import ReachPreview, reach_preview
from server.jobs.plans.unmoved import moved_since_look
from server.jobs.requests import MachineReading
from server.targets.contracts import AnchoredTarget, SurfacePatch
from server.targets.taught import TaughtObject

NOT_PREVIEWED = ReachPreview("unknown", "")
Preview = Callable[[int, AnchoredTarget], ReachPreview]


def reach_in_image(cell: Cell, ctx: PlanContext, image: int, target: AnchoredTarget) -> ReachPreview:
    """Whether a job could reach a candidate measured in that image, from where the machine rests."""
    report = next((shown for shown in reversed(cell.vision.reports_since(0)) if shown.sequence == image), None)
    if report is None:
        return ReachPreview("unknown", f"reach is not known: image {image} is not kept; choose in a newer one")
    latest = cell.link.latest
    if latest is None or mono_ns() - latest.t_mono_ns > SILENT_S * 1e9:
        return ReachPreview("unknown", "reach is not known: the PLC is silent; check its connection")
    then = cell.link.samples_since(report.t_receive_mono_ns)
    moved = moved_since_look(cell.machine, latest.q_rad, np.array((then or [latest])[0].q_rad))
    if moved:
        return ReachPreview("unknown", f"reach is not known: {moved.replace('look again', 'choose in a newer image')}")
    reading = MachineReading(np.array(latest.q_rad), np.array(latest.q_ref_rad), latest.t_plc_ns, latest.t_mono_ns)
    return reach_preview(ctx, reading, report.observation.tool, target, target.T_ref_target)


class TargetChoice:
    """The candidate that was measured last, and the target in use."""

    def __init__(
        self, vision: VisionClient, knowledge: Knowledge, engine: JobEngine, preview: Preview | None = None
    ) -> None:
        self._vision, self._knowledge, self._engine = vision, knowledge, engine
        self._preview = preview
        self.candidate: AnchoredTarget | SurfacePatch | None = None
        self.reach = NOT_PREVIEWED  # of the candidate
        self.image = 0  # sequence number of the candidate's image

    @property
    def target(self) -> AnchoredTarget | None:
        """The chosen place in use; None for markers and for a taught object."""
        target = self._knowledge.target
        return target if isinstance(target, AnchoredTarget) else None

    @property
    def taught(self) -> TaughtObject | None:
        """The taught object in use."""
        target = self._knowledge.target
        return target if isinstance(target, TaughtObject) else None

    def use_object(self, taught: TaughtObject) -> None:
        """Use a taught object as the object of interest.

        Raises: BusyError: a job is running.
        """
        self._require_idle()
        self.candidate = None
        self._use(taught)

    async def measure(self, image: int, pixel: tuple[float, float], roll_deg: float) -> AnchoredTarget | SurfacePatch:
        """Measure a candidate and preview its reach; nothing else changes.

        Raises: CameraError: no answer from the vision process.
        """
        found = await self._vision.measure_target(image, pixel, float(np.deg2rad(roll_deg)))
        reach = NOT_PREVIEWED
        if isinstance(found, AnchoredTarget) and self._preview is not None:
            reach = await asyncio.to_thread(self._preview, image, found)
        self.candidate, self.image, self.reach = found, image, reach
        return found

    async def find_marks(self, image: int, diameters_mm: tuple[float, ...]) -> MarksFound:
        """Find boreholes and rings; each can be accepted by its target's number until the next search.

        Raises: CameraError: no answer from the vision process.
        """
        found = await self._vision.find_marks(image, tuple(1e-3 * diameter for diameter in diameters_mm))
        self._knowledge.marks = tuple(target for _, target in found.marks if isinstance(target, AnchoredTarget))
        return found

    def accept(self, target_id: int) -> AnchoredTarget:
        """Use the candidate as the object of interest.

        Raises: BusyError: a job is running. JobFailedError: no candidate or mark has that number any more.
        """
        self._require_idle()
        known = (self.candidate, *self._knowledge.marks)
        targets = (target for target in known if isinstance(target, AnchoredTarget))
        found = next((target for target in targets if target.target_id == target_id), None)
        if found is None:
            raise JobFailedError(
                f"target {target_id} is neither the candidate that was measured last nor one of the marks that were "
                "found last; measure it again",
                "no_such_target",
            )
        self._use(found)
        self.candidate = None
        return found

    def clear(self) -> None:
        """Use the markers again.

        Raises: BusyError: a job is running.
        """
        self._require_idle()
        self.candidate = None
        self._use(None)

    def _use(self, target: AnchoredTarget | TaughtObject | None) -> None:
        self._vision.use_target(target)
        self._knowledge.use_target(target)

    def _require_idle(self) -> None:
        job = self._engine.current
        if job is not None and not job.ended:
            raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; choose after it", {})
