"""Teaching objects: views are collected, made into an object, kept as files, and chosen as the object of interest."""

import asyncio
from pathlib import Path

import numpy as np

from machine.description import StereoCamera
from server.camera.client import VisionClient
from server.errors import JobFailedError
from server.jobs.targets import TargetChoice
from server.store.errors import StoreError
from server.targets.contracts import TargetSettings
from server.targets.taught import ObjectBox, TaughtObject, TaughtView, teach_object
from server.targets.taught_files import SUFFIX, TaughtFileError, load_taught, save_taught

VIEWS_MAX = 12  # 4 MB each; more sides than an object on a wall has


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

    def names(self) -> list[str]:
        """Of all taught objects."""
        return sorted(path.stem for path in self._folder.glob(f"*{SUFFIX}"))

    async def add_view(self, image: int, box: ObjectBox) -> TaughtView:
        """Measure one view; a box that differs from the last view's begins another object.

        Raises: JobFailedError: it cannot be used, and why. CameraError: no answer from the vision process.
        """
        if self._choice.taught is not None or self._choice.target is not None:
            raise JobFailedError("a target is in use; go back to markers, which give the object's frame", "not_markers")
        if self.box is None or not (_equal(self.box.centre_m, box.centre_m) and _equal(self.box.size_m, box.size_m)):
            self.forget()
        if len(self.views) >= VIEWS_MAX:
            raise JobFailedError(
                f"{len(self.views)} views are kept (limit {VIEWS_MAX}); teach the object", "too_many_views"
            )
        found = await self._vision.teach_view(image, box)
        if isinstance(found, str):
            raise JobFailedError(found, "view_refused")
        self.box = box
        self.views.append(found)
        return found

    def forget(self) -> None:
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
        self.forget()
        return found

    async def use(self, name: str) -> TaughtObject:
        """Use an object as the object of interest.

        Raises: JobFailedError: there is none of that name, or its file cannot be read. BusyError: a job is running.
        """
        if name not in self.names():
            raise JobFailedError(f"no object '{name}' has been taught; see the list", "no_such_object")
        try:
            found = await asyncio.to_thread(load_taught, self._folder / f"{name}{SUFFIX}")
        except TaughtFileError as error:
            raise JobFailedError(str(error), "object_unreadable") from error
        self._choice.use_object(found)
        return found

    def remove(self, name: str) -> None:
        """Forget a taught object.

        Raises: JobFailedError: there is none of that name, or it is in use.
        """
        if name not in self.names():
            raise JobFailedError(f"no object '{name}' has been taught; see the list", "no_such_object")
        if name == self.in_use:
            raise JobFailedError(f"object '{name}' is in use; go back to markers first", "object_in_use")
        (self._folder / f"{name}{SUFFIX}").unlink(missing_ok=True)


def _equal(first: np.ndarray, second: np.ndarray) -> bool:
    return bool(np.allclose(first, second))
