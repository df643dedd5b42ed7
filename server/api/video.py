"""The camera picture for the page: encoded once a frame by the vision process, only ever the newest for a viewer.

One binary message a frame: length of the header (uint32, little endian), header (JSON), picture (JPEG). The header
holds what was found in that very picture, so that the overlay never belongs to another one. A viewer says "next" for
every frame it has drawn; two may be under way, so a slow one skips frames instead of falling behind.
"""

import asyncio
import contextlib
import struct

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from machine.camera import project
from machine.description import StereoCamera
from machine.rotations import Array
from recording.clock import mono_ns
from server.api.callers import accept_socket
from server.api.views import View
from server.camera.contracts import FrameReport
from server.jobs.cell import Cell
from server.jobs.context import PlanContext
from server.jobs.service import JobService
from server.vision.contracts import MarkerView, ObjectPose, PoseStatus

# What is drawn over one picture: markers, tool and goal as this very pair shows them, in px of the full left image.

SEEN_POSE_STATUSES = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)
DRAWN_AXIS_LENGTH_M = 0.05


class MarkerOverlay(View):
    """One marker: corners, how well it fits, or why it was not used."""

    marker_id: int
    on: str
    corners_px: list[list[float]]
    residual_px: float
    used: bool
    reason: str


class CrossOverlay(View):
    """An origin and the ends of its x, y, z axes (50 mm)."""

    origin_px: list[float]
    axes_px: list[list[float]]


class FrameOverlay(View):
    """Header of one video frame. `age_ms` is the age when it was packed."""

    number: int
    age_ms: float
    exposure_mono_ms: float
    width_px: int
    height_px: int
    picture_width_px: int
    fps: float
    markers: list[MarkerOverlay]
    tool: CrossOverlay | None
    goal: CrossOverlay | None
    warnings: list[str]
    masks_px: list[list[list[float]]]  # polygons of the settings: nothing of the scene is looked for there


def overlay_of(cell: Cell, ctx: PlanContext, report: FrameReport, age_ms: float) -> FrameOverlay:
    """The header of this pair's picture."""
    camera, seen = cell.machine.camera, report.observation
    targets = (cell.machine.markers_on("tool"), cell.machine.boards_on("tool"))
    tool_ids = {marker.marker_id for marker in targets[0]} | {board.first_id for board in targets[1]}
    return FrameOverlay(
        number=report.sequence,
        age_ms=round(age_ms, 1),
        exposure_mono_ms=round(report.t_exposure_mapped_ns * 1e-6, 3),
        width_px=camera.width_px,
        height_px=camera.height_px,
        picture_width_px=report.preview_width_px,
        fps=round(report.fps, 1),
        markers=[_marker_overlay(view, tool_ids) for view in seen.marker_views if view.corners_left_px is not None],
        tool=_axes_overlay(camera, _seen_pose(seen.tool)),
        goal=_goal_overlay(camera, seen.ooi, ctx.T_ooi_goal),
        warnings=list(report.warnings),
        masks_px=[np.round(polygon, 1).tolist() for polygon in cell.vision.masks[0]],
    )


def _marker_overlay(view: MarkerView, tool_ids: set[int]) -> MarkerOverlay:
    corners = np.zeros((0, 2)) if view.corners_left_px is None else view.corners_left_px
    return MarkerOverlay(
        marker_id=view.marker_id,
        on="tool" if view.marker_id in tool_ids else "target",
        corners_px=np.round(corners, 1).tolist(),
        residual_px=round(float(np.nan_to_num(view.residual_rms_px)), 2),
        used=view.used,
        reason=view.reason,
    )


def _seen_pose(found: ObjectPose) -> Array | None:
    return found.T_cam_object if found.status in SEEN_POSE_STATUSES else None


def _goal_overlay(camera: StereoCamera, ooi: ObjectPose, T_ooi_goal: Array) -> CrossOverlay | None:
    T_cam_ooi = _seen_pose(ooi)
    return None if T_cam_ooi is None else _axes_overlay(camera, T_cam_ooi @ T_ooi_goal)


def _axes_overlay(camera: StereoCamera, T_cam_object: Array | None) -> CrossOverlay | None:
    """Projection of an object's origin and axes; None behind the camera."""
    if T_cam_object is None:
        return None
    ends_cam = T_cam_object[:3, 3] + DRAWN_AXIS_LENGTH_M * np.vstack([np.zeros(3), T_cam_object[:3, :3].T])
    if ends_cam[:, 2].min() <= 0.01:
        return None
    points = np.round(project(camera, ends_cam), 1).tolist()
    return CrossOverlay(origin_px=points[0], axes_px=points[1:])


FRAMES_IN_FLIGHT_MAX = 2


class VideoHub:
    """The newest frame, and who waits for it. Belongs to one event loop."""

    def __init__(self, service: JobService) -> None:
        self._service = service
        self._arrived = asyncio.Event()
        self._number = 0
        self._message = b""
        self.viewers = 0
        service.cell.vision.on_report(self._pack_video_frame)

    def _pack_video_frame(self, report: FrameReport) -> None:
        """Packed once for all viewers; without viewers nothing is packed."""
        if report.preview_jpeg is None or self.viewers == 0:
            return
        age_ms = (mono_ns() - report.t_receive_mono_ns) * 1e-6
        header = overlay_of(self._service.cell, self._service.context, report, age_ms).model_dump_json().encode()
        self._message = struct.pack("<I", len(header)) + header + report.preview_jpeg
        self._number += 1
        self._arrived.set()
        self._arrived = asyncio.Event()

    async def frame_after(self, number: int) -> tuple[int, bytes]:
        """The newest frame, as soon as there is one after that number."""
        while self._number <= number:
            await self._arrived.wait()
        return self._number, self._message

    @property
    def newest_number(self) -> int:
        """Of the newest frame."""
        return self._number


def video_router(service: JobService) -> APIRouter:
    """Route /v1/video."""
    router = APIRouter()
    hub = VideoHub(service)

    @router.websocket("/v1/video")
    async def video(socket: WebSocket) -> None:
        if not await accept_socket(socket):
            return
        hub.viewers += 1
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await _stream_to_viewer(socket, hub)
        finally:
            hub.viewers -= 1

    return router


async def _stream_to_viewer(socket: WebSocket, hub: VideoHub) -> None:
    room = asyncio.Semaphore(FRAMES_IN_FLIGHT_MAX)
    sending = asyncio.create_task(_send(socket, hub, room))
    drawn = asyncio.create_task(_count_drawn(socket, room))
    try:
        await asyncio.wait({sending, drawn}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, drawn):
            task.cancel()
        await asyncio.gather(sending, drawn, return_exceptions=True)


async def _send(socket: WebSocket, hub: VideoHub, room: asyncio.Semaphore) -> None:
    number = hub.newest_number
    while True:
        await room.acquire()
        number, message = await hub.frame_after(number)
        await socket.send_bytes(message)


async def _count_drawn(socket: WebSocket, room: asyncio.Semaphore) -> None:
    while True:
        await socket.receive_text()
        room.release()
