"""Choosing the object of interest: measured first, accepted then; what was seen of the former one is forgotten."""

import numpy as np

from server.camera.client import VisionClient
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

    def accept(self, target_id: int) -> AnchoredTarget:
        """Use the candidate as the object of interest.

        Raises: BusyError: a job is running. JobFailedError: that candidate is not the one that was measured last.
        """
        self._require_idle()
        found = self.candidate
        if not isinstance(found, AnchoredTarget) or found.target_id != target_id:
            raise JobFailedError(
                f"target {target_id} is not the candidate that was measured last; measure it again", "no_such_target"
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
        knowledge = self._knowledge
        knowledge.target = target
        knowledge.forget_sight()
        knowledge.looks.clear()  # they saw another object
        knowledge.joint = None
        knowledge.moves.clear()

    def _require_idle(self) -> None:
        job = self._engine.current
        if job is not None and not job.ended:
            raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; choose after it", {})
