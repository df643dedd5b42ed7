"""Choosing the object of interest: measured first, accepted then; what was seen of the former one is forgotten."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np

from machine.description import StereoCamera
from recording.clock import mono_ns
from server.camera.client import VisionClient
from server.camera.contracts import MarksFound
from server.errors import BusyError, JobFailedError
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.engine import JobEngine
from server.jobs.knowledge import Knowledge
from server.jobs.performer import PLC_SILENCE_MAX_S
from server.jobs.plans.reach import ReachPreview, reach_preview
from server.jobs.plans.unmoved import moved_since_look
from server.jobs.requests import MachineReading
from server.store.database import StoreError
from server.targets.contracts import AnchoredTarget, SurfacePatch, TargetSettings
from server.targets.taught import ObjectBox, TaughtObject, TaughtView, teach_object
from server.targets.taught_files import SUFFIX, TaughtFileError, load_taught, save_taught

UNKNOWN_REACH = ReachPreview("unknown", "")
Preview = Callable[[int, AnchoredTarget], ReachPreview]


def reach_in_image(cell: Cell, ctx: PlanContext, image: int, target: AnchoredTarget) -> ReachPreview:
    """Whether a job could reach a candidate measured in that image, from where the machine rests."""
    report = next((shown for shown in reversed(cell.vision.reports_since(0)) if shown.sequence == image), None)
    if report is None:
        return ReachPreview("unknown", f"reach is not known: image {image} is not kept; choose in a newer one")
    latest = cell.link.latest
    if latest is None or mono_ns() - latest.t_mono_ns > PLC_SILENCE_MAX_S * 1e9:
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
        self.reach = UNKNOWN_REACH  # of the candidate
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
        """Use a taught object as the object of interest. Raises: BusyError: a job is running."""
        self._require_idle()
        self.candidate = None
        self._set_active_target(taught)

    async def measure(self, image: int, pixel: tuple[float, float], roll_deg: float) -> AnchoredTarget | SurfacePatch:
        """Measure a candidate and preview its reach; nothing else changes.

        Raises: CameraError: no answer from the vision process.
        """
        found = await self._vision.measure_target(image, pixel, float(np.deg2rad(roll_deg)))
        reach = UNKNOWN_REACH
        if isinstance(found, AnchoredTarget) and self._preview is not None:
            reach = await asyncio.to_thread(self._preview, image, found)
        self.candidate, self.image, self.reach = found, image, reach
        return found

    async def find_marks(self, image: int, diameters_mm: tuple[float, ...]) -> MarksFound:
        """Find boreholes and rings; each can be accepted by its target's number until the next search.

        Raises: CameraError: no answer from the vision process.
        """
        found = await self._vision.find_marks(image, tuple(1e-3 * diameter for diameter in diameters_mm))
        self._knowledge.found_marks = tuple(
            target for _, target in found.marks_with_targets if isinstance(target, AnchoredTarget)
        )
        return found

    def accept(self, target_id: int) -> AnchoredTarget:
        """Use the candidate as the object of interest.

        Raises: BusyError: a job is running. JobFailedError: no candidate or mark has that number any more.
        """
        self._require_idle()
        known = (self.candidate, *self._knowledge.found_marks)
        targets = (target for target in known if isinstance(target, AnchoredTarget))
        found = next((target for target in targets if target.target_id == target_id), None)
        if found is None:
            raise JobFailedError(
                f"target {target_id} is neither the candidate that was measured last nor one of the marks that were "
                "found last; measure it again",
                "no_such_target",
            )
        self._set_active_target(found)
        self.candidate = None
        return found

    def clear(self) -> None:
        """Use the markers again. Raises: BusyError: a job is running."""
        self._require_idle()
        self.candidate = None
        self._set_active_target(None)

    def _set_active_target(self, target: AnchoredTarget | TaughtObject | None) -> None:
        self._vision.use_target(target)
        self._knowledge.use_target(target)

    def _require_idle(self) -> None:
        job = self._engine.current
        if job is not None and not job.has_ended:
            raise BusyError(f"job {job.job_id} ({job.kind}) of {job.owner} is {job.state.value}; choose after it", {})


# Teaching objects: views are collected, made into an object, kept as files, and chosen as the object of interest.

TAUGHT_VIEWS_MAX = 12  # 4 MB each; more sides than an object on a wall has


class Teaching:
    """The views of the object that is being taught, and the folder of those that have been."""

    def __init__(self, vision: VisionClient, choice: TargetChoice, camera: StereoCamera, folder: Path) -> None:
        self._vision, self._choice, self._camera, self._folder = vision, choice, camera, folder
        self.box: ObjectBox | None = None
        self.views: list[TaughtView] = []

    @property
    def in_use(self) -> str:
        """The name of the object in use; empty without one."""
        taught = self._choice.taught
        return "" if taught is None else taught.name

    def object_names(self) -> list[str]:
        """Of all taught objects."""
        return sorted(path.stem for path in self._folder.glob(f"*{SUFFIX}"))

    async def add_view(self, image: int, box: ObjectBox) -> TaughtView:
        """Measure one view; a box that differs from the last view's begins another object.

        Raises: JobFailedError: it cannot be used, and why. CameraError: no answer from the vision process.
        """
        if self._choice.taught is not None or self._choice.target is not None:
            raise JobFailedError("a target is in use; go back to markers, which give the object's frame", "not_markers")
        if self.box is None or not (
            _has_equal_values(self.box.centre_m, box.centre_m) and _has_equal_values(self.box.size_m, box.size_m)
        ):
            self.forget_views()
        if len(self.views) >= TAUGHT_VIEWS_MAX:
            raise JobFailedError(
                f"{len(self.views)} views are kept (limit {TAUGHT_VIEWS_MAX}); teach the object", "too_many_views"
            )
        found = await self._vision.teach_view(image, box)
        if isinstance(found, str):
            raise JobFailedError(found, "view_refused")
        self.box = box
        self.views.append(found)
        return found

    def forget_views(self) -> None:
        """Drop the views that were taken."""
        self.box = None
        self.views.clear()

    async def teach(self, name: str) -> TaughtObject:
        """Make the views into an object and keep it; one of the same name is replaced.

        Raises: JobFailedError: the views do not suffice, and why. StoreError: it cannot be written.
        """
        if self.box is None:
            raise JobFailedError("no view has been taken; take at least two", "not_taught")
        found = await asyncio.to_thread(teach_object, name, tuple(self.views), self.box, self._camera, TargetSettings())
        if isinstance(found, str):
            raise JobFailedError(found, "not_taught")
        try:
            await asyncio.to_thread(save_taught, self._folder, found)
        except OSError as error:
            raise StoreError(f"object '{name}' was not kept: {error}; free the disk and teach again") from error
        self.forget_views()
        return found

    async def use_object(self, name: str) -> TaughtObject:
        """Use an object as the object of interest.

        Raises: JobFailedError: no object has that name, or its file cannot be read. BusyError: a job is running.
        """
        if name not in self.object_names():
            raise JobFailedError(f"no object '{name}' has been taught; see the list", "no_such_object")
        try:
            found = await asyncio.to_thread(load_taught, self._folder / f"{name}{SUFFIX}")
        except TaughtFileError as error:
            raise JobFailedError(str(error), "object_unreadable") from error
        self._choice.use_object(found)
        return found

    def remove(self, name: str) -> None:
        """Forget a taught object. Raises: JobFailedError: no object has that name, or it is in use."""
        if name not in self.object_names():
            raise JobFailedError(f"no object '{name}' has been taught; see the list", "no_such_object")
        if name == self.in_use:
            raise JobFailedError(f"object '{name}' is in use; go back to markers first", "object_in_use")
        (self._folder / f"{name}{SUFFIX}").unlink(missing_ok=True)


def _has_equal_values(first: np.ndarray, second: np.ndarray) -> bool:
    return bool(np.allclose(first, second))
