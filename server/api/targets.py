"""Choosing a target without markers: measured at a pixel of an image, accepted, cleared."""

from pathlib import Path as FolderPath
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Path
from fastapi.responses import JSONResponse, Response
from pydantic import Field

from machine.camera import project
from machine.description import StereoCamera
from machine.poses import transform_points
from server.api.lease import require_lease
from server.api.problems import problem_response
from server.api.views import Problem, Strict, View
from server.camera.contracts import MarksFound
from server.jobs.plans.reach import ReachPreview
from server.jobs.service import JobService
from server.jobs.targets import UNKNOWN_REACH, TargetChoice, Teaching, reach_in_image
from server.targets.contracts import AnchoredTarget, SurfacePatch
from server.targets.surface import CHI2_2_95, uncertainty_95
from server.targets.taught import ObjectBox, TaughtView
from server.vision.contracts import Array

# Taught objects over REST: take views, teach, list, use, remove.

OBJECT_NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$"  # it becomes a file's name
ObjectName = Annotated[str, Field(pattern=OBJECT_NAME_PATTERN)]
ObjectPath = Annotated[str, Path(pattern=OBJECT_NAME_PATTERN)]
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
    control = Depends(require_lease(service.engine.leases))

    def view() -> ObjectsView:
        return ObjectsView(
            names=teaching.object_names(),
            in_use=teaching.in_use,
            view_landmarks=[_mark_count(taken) for taken in teaching.views],
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
        teaching.forget_views()
        return view()

    @router.post("", response_model=ObjectsView, responses=REFUSED)
    async def teach_object_of_views(body: TeachRequest) -> ObjectsView:
        """Make the views into an object and keep it."""
        await teaching.teach(body.name)
        return view()

    @router.post("/{name}/use", response_model=ObjectsView, responses=REFUSED, dependencies=[control])
    async def use_object(name: ObjectPath) -> ObjectsView:
        """Use a taught object as the object of interest: look at it before anything moves."""
        await teaching.use_object(name)
        return view()

    @router.delete("/{name}", response_model=ObjectsView, responses=REFUSED, dependencies=[control])
    async def remove_object(name: ObjectPath) -> ObjectsView:
        """Remove a taught object that is not in use."""
        teaching.remove(name)
        return view()

    return router


def _mark_count(view: TaughtView) -> int:
    return len(view.landmarks)


DRAWN_AXIS_LENGTH_M = 0.05
IMAGE: dict[int | str, dict[str, Any]] = {
    200: {"description": "the newest image of the left eye", "content": {"image/jpeg": {"schema": {"type": "string"}}}},
    404: {"model": Problem},
}


class MeasureTargetRequest(Strict):
    """A pixel of the left eye in full resolution, in the image with that number (video header, GET /v1/target)."""

    image: Annotated[int, Field(ge=0, le=2**53)]
    u_px: Annotated[float, Field(ge=0.0, le=16384.0)]
    v_px: Annotated[float, Field(ge=0.0, le=16384.0)]
    roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0


class FindMarksRequest(Strict):
    """Search that image for boreholes and painted rings of these outer diameters."""

    image: Annotated[int, Field(ge=0, le=2**53)]
    diameters_mm: list[Annotated[float, Field(ge=15.0, le=400.0)]] = Field(min_length=1, max_length=8)


class TargetRequest(Strict):
    """Which measured candidate or found mark is meant: one that has been replaced meanwhile is refused."""

    target_id: Annotated[int, Field(ge=1, le=2**53)]


class PatchView(View):
    """A measured surface patch; figures are 0 and lists empty when it was refused. Uncertainties at 95 %."""

    target_id: int
    status: str
    reason: str
    image: int
    u_px: float
    v_px: float
    distance_mm: float
    normal_deg: float = Field(description="uncertainty of the normal")
    position_mm: float = Field(description="uncertainty of the position along its worst axis")
    radius_mm: float
    shape: str
    oblique_deg: float = Field(description="view ray against the normal")
    outline_px: list[list[float]] = Field(description="rim of the measured patch in the left image")
    ellipse_px: list[list[float]] = Field(description="95 % ellipse of the position in the surface, magnified 10 times")
    axes_px: list[list[float]] = Field(description="origin and the ends of x, y and the normal (50 mm)")
    reach: str = Field(description="reachable, refused or unknown: the planner's check of a whole job, when measured")
    reach_reason: str = Field(description="which leg the planner refuses and what helps, or why reach is not known")


class MarkView(View):
    """One borehole or ring; `patch.target_id` is what `POST /v1/target` and the job `pattern` take, 0 if refused."""

    number: int
    diameter_mm: float
    sigma_diameter_mm: float
    nominal_mm: float
    dark_inside: bool
    patch: PatchView


class MarksView(View):
    """Marks from left to right, numbered from 1; reason: why that image could not be searched."""

    image: int
    reason: str
    marks: list[MarkView]


class TargetView(View):
    """The target in use, the candidate that was measured last, and the number of the newest image."""

    target: PatchView | None
    candidate: PatchView | None
    image: int


def target_router(service: JobService) -> APIRouter:
    """Routes under /v1/target."""
    router = APIRouter(prefix="/v1/target", tags=["target"])
    cell = service.cell
    choice = TargetChoice(
        cell.vision,
        cell.knowledge,
        service.engine,
        lambda image, found: reach_in_image(cell, service.context, image, found),
    )
    router.include_router(taught_object_router(service, choice))
    control = Depends(require_lease(service.engine.leases))
    refused: dict[int | str, dict[str, Any]] = {status: {"model": Problem} for status in (403, 409, 422, 503)}

    def view() -> TargetView:
        camera, latest = cell.machine.camera, cell.vision.latest
        return TargetView(
            target=None if choice.target is None else patch_view(choice.target, 0, camera),
            candidate=None
            if choice.candidate is None
            else patch_view(choice.candidate, choice.image, camera, choice.reach),
            image=0 if latest is None else latest.sequence,
        )

    @router.get("", response_model=TargetView)
    async def read_target() -> TargetView:
        """The target in use and the last candidate."""
        return view()

    @router.get("/image", response_model=None, response_class=Response, responses=IMAGE)
    async def read_target_image() -> Response:
        """The newest image; the header Longreach-Image holds its number, Longreach-Scale its size over the eye's."""
        reports = reversed(cell.vision.reports_since(0))
        shown = next((report for report in reports if report.preview_jpeg is not None), None)
        if shown is None or shown.preview_jpeg is None:
            return problem_response(404, "No image", "no image has come yet; check the camera", "no_image")
        scale = shown.preview_width_px / cell.machine.camera.width_px
        headers = {"Longreach-Image": str(shown.sequence), "Longreach-Scale": f"{scale:.6f}"}
        return Response(shown.preview_jpeg, media_type="image/jpeg", headers=headers)

    @router.post("/measure", response_model=PatchView, responses=refused)
    async def measure_target(body: MeasureTargetRequest) -> PatchView:
        """Measure the surface at a pixel; nothing moves and nothing is used yet. A refusal is in `status`, `reason`."""
        found = await choice.measure(body.image, (body.u_px, body.v_px), body.roll_deg)
        return patch_view(found, body.image, cell.machine.camera, choice.reach)

    @router.post("/marks", response_model=MarksView, responses=refused)
    async def find_marks(body: FindMarksRequest) -> MarksView:
        """Find boreholes and rings of known diameter; nothing moves and nothing is used yet."""
        found = await choice.find_marks(body.image, tuple(body.diameters_mm))
        return marks_view(found, body.image, cell.machine.camera)

    @router.post("", response_model=TargetView, responses=refused, dependencies=[control])
    async def use_target(body: TargetRequest) -> TargetView | JSONResponse:
        """Use the measured candidate, or a found mark, as the object of interest: look at it before anything moves."""
        choice.accept(body.target_id)
        return view()

    @router.delete("", response_model=TargetView, responses=refused, dependencies=[control])
    async def clear_target() -> TargetView:
        """Use the object's markers again."""
        choice.clear()
        return view()

    return router


def marks_view(found: MarksFound, image: int, camera: StereoCamera) -> MarksView:
    """Found marks as they are shown: in px of their image."""
    marks = [
        MarkView(
            number=mark.number,
            diameter_mm=1e3 * mark.diameter_m,
            sigma_diameter_mm=1e3 * mark.sigma_diameter_m,
            nominal_mm=1e3 * mark.nominal_m,
            dark_inside=mark.dark_inside,
            patch=patch_view(target, image, camera),
        )
        for mark, target in found.marks_with_targets
    ]
    return MarksView(image=image, reason=found.reason, marks=marks)


def patch_view(
    found: AnchoredTarget | SurfacePatch, image: int, camera: StereoCamera, reach: ReachPreview = UNKNOWN_REACH
) -> PatchView:
    """A candidate as it is shown: in px of its own image."""
    patch = found.patch if isinstance(found, AnchoredTarget) else found
    target_id = found.target_id if isinstance(found, AnchoredTarget) else 0
    T, C = patch.T_cam_target, patch.covariance
    common = {
        "target_id": target_id,
        "status": patch.status.value,
        "reason": patch.reason,
        "image": image,
        "u_px": patch.pixel[0],
        "v_px": patch.pixel[1],
        "reach": reach.status,
        "reach_reason": reach.reason,
    }
    if T is None or C is None:
        zero = dict.fromkeys(("distance_mm", "normal_deg", "position_mm", "radius_mm", "oblique_deg"), 0.0)
        return PatchView(**common, **zero, shape="", outline_px=[], ellipse_px=[], axes_px=[])
    normal_deg, position_m = uncertainty_95(C)
    view = T[:3, 3] / np.linalg.norm(T[:3, 3])
    ends = np.vstack([np.zeros(3), DRAWN_AXIS_LENGTH_M * np.eye(3)])
    return PatchView(
        **common,
        distance_mm=float(1e3 * np.linalg.norm(T[:3, 3])),
        normal_deg=normal_deg,
        position_mm=1e3 * position_m,
        radius_mm=1e3 * patch.radius_m,
        shape=patch.surface_shape,
        oblique_deg=float(np.rad2deg(np.arccos(np.clip(-view @ T[:3, 2], -1.0, 1.0)))),
        outline_px=_rounded_points(_outline_px(T, patch.radius_m, camera)),
        ellipse_px=_rounded_points(_ellipse_px(T, C, camera)),
        axes_px=_rounded_points(project(camera, transform_points(T, ends))),
    )


ELLIPSE_MAGNIFICATION = 10.0  # times its size: a tenth of a millimetre would not be visible


def _ellipse_px(T: Array, C: Array, camera: StereoCamera) -> Array:
    """Section (24, 2) [px] of the position's 95 % ellipsoid with the surface's x and the depth, projected."""
    values, vectors = np.linalg.eigh(C[3:, 3:])
    half = np.sqrt(CHI2_2_95 * np.maximum(values[[2, 1]], 0.0)) * ELLIPSE_MAGNIFICATION
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.cos(angle)[:, None] * half[0] * vectors[:, 2] + np.sin(angle)[:, None] * half[1] * vectors[:, 1]
    return project(camera, T[:3, 3] + ring)


def _rounded_points(points: Array) -> list[list[float]]:
    return np.round(points, 1).tolist()


def _outline_px(T: Array, radius_m: float, camera: StereoCamera, n: int = 24) -> Array:
    """Raw left pixels (n, 2) of the patch's rim."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    circle = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.zeros(n)])
    return project(camera, transform_points(T, circle))
