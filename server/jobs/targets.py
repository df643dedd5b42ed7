"""Choosing the object of interest: measured first, accepted then; what was seen of the former one is forgotten."""

import numpy as np

from server.camera.client import VisionClient
from server.camera.contracts import MarksFound
from server.errors import BusyError, JobFailedError
from server.jobs.engine import JobEngine
from server.jobs.knowledge import Knowledge
from server.targets.contracts import AnchoredTarget, SurfacePatch


class TargetChoice:
    """The candidate that was measured last, and the target in use."""

    def __init__(self, vision: VisionClient, knowledge: Knowledge, engine: JobEngine) -> None:
        self._vision, self._knowledge, self._engine = vision, knowledge, engine
        self.candidate: AnchoredTarget | SurfacePatch | None = None
        self.image = 0  # sequence number of the candidate's image

    @property
    def target(self) -> AnchoredTarget | None:
        """The target in use."""
        return self._knowledge.target

    async def measure(self, image: int, pixel: tuple[float, float], roll_deg: float) -> AnchoredTarget | SurfacePatch:
        """Measure a candidate; nothing else changes.

        Raises: CameraError: no answer from the vision process.
        """
        found = await self._vision.measure_target(image, pixel, float(np.deg2rad(roll_deg)))
        self.candidate, self.image = found, image
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

    def _use(self, target: AnchoredTarget | None) -> None:
        self._vision.use_target(target)
        self._knowledge.use_target(target)

    def _require_idle(self) -> None:
        job = self._engine.current
        if job is not None and not job.ended:
            raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; choose after it", {})
