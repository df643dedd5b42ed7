"""Taught objects over REST: take views, teach, list, use, remove."""

from pathlib import Path as FolderPath
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Path
from pydantic import Field

from server.api.lease import leased
from server.api.views import Problem, Strict, View
from server.jobs.service import JobService
from server.jobs.targets import TargetChoice
from server.jobs.teaching import Teaching
from server.targets.taught import ObjectBox, TaughtView

NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$"  # it becomes a file's name
ObjectName = Annotated[str, Field(pattern=NAME)]
ObjectPath = Annotated[str, Path(pattern=NAME)]
Offset = Annotated[float, Field(ge=-5000.0, le=5000.0)]
Length = Annotated[float, Field(ge=10.0, le=5000.0)]
REFUSED: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (403, 409, 422, 503)}


class TeachViewRequest(Strict):
    """One view: the image's number, and where the object is in the axes of the OOI's markers next to it.

    The object's frame has the markers' axes and lies at `centre_mm`; the goal's stand-off is along its z axis.
    """

    image: Annotated[int, Field(ge=0, le=2**53)]
    centre_mm: Annotated[
        list[Offset], Field(min_length=3, max_length=3, description="x right, y up, z out of the wall")
    ]
    size_mm: Annotated[list[Length], Field(min_length=3, max_length=3, description="full width, height and depth")]


class TeachRequest(Strict):
    """The name that the views taken so far are kept under."""

    name: ObjectName


class ObjectsView(View):
    """Taught objects, the one in use (or empty), and the views of the one that is being taught."""

    names: list[str]
    in_use: str
    view_landmarks: list[int] = Field(description="landmarks of each view taken so far")


def taught_object_router(service: JobService, choice: TargetChoice) -> APIRouter:
    """Routes under /v1/target/objects."""
    router = APIRouter(prefix="/objects", tags=["target"])
    cell = service.cell
    folder = FolderPath(cell.settings.recording.folder) / "objects"
    teaching = Teaching(cell.vision, choice, cell.machine.camera, folder)
    control = Depends(leased(service.engine.leases))

    def view() -> ObjectsView:
        return ObjectsView(
            names=teaching.names(), in_use=teaching.in_use, view_landmarks=[_count(taken) for taken in teaching.views]
        )

    @router.get("", response_model=ObjectsView)
    async def read_objects() -> ObjectsView:
        """The taught objects and the views taken so far."""
        return view()

    @router.post("/views", response_model=ObjectsView, responses=REFUSED)
    async def take_object_view(body: TeachViewRequest) -> ObjectsView:
        """Take a view of the object with its markers in the picture; nothing moves. Another box starts over."""
        box = ObjectBox(1e-3 * np.array(body.centre_mm), 1e-3 * np.array(body.size_mm))
        await teaching.add_view(body.image, box)
        return view()

    @router.delete("/views", response_model=ObjectsView, responses=REFUSED)
    async def forget_object_views() -> ObjectsView:
        """Forget the views taken so far."""
        teaching.forget()
        return view()

    @router.post("", response_model=ObjectsView, responses=REFUSED)
    async def teach_object_of_views(body: TeachRequest) -> ObjectsView:
        """Make the views into an object and keep it."""
        await teaching.teach(body.name)
        return view()

    @router.post("/{name}/use", response_model=ObjectsView, responses=REFUSED, dependencies=[control])
    async def use_object(name: ObjectPath) -> ObjectsView:
        """Use a taught object as the object of interest: look at it before anything moves."""
        await teaching.use(name)
        return view()

    @router.delete("/{name}", response_model=ObjectsView, responses=REFUSED, dependencies=[control])
    async def remove_object(name: ObjectPath) -> ObjectsView:
        """Remove a taught object that is not in use."""
        teaching.remove(name)
        return view()

    return router


def _count(view: TaughtView) -> int:
    return len(view.marks)
