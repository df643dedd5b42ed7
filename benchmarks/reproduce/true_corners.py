"""Where a world's marker corners truly fall in both images: true lens, rig, mount, printing and layout."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from machine.camera import project
from machine.description import Marker, StereoCamera
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from machine.rotations import Array
from machine.visibility import faces_eye, in_eye
from sim_plc.camera.boards import marker_board, shank_board
from sim_plc.world import World

ObjectOn = Literal["tool", "ooi"]
EyeName = Literal["left", "right"]
EYES: tuple[EyeName, ...] = ("left", "right")
MARGIN_PX = 4.0  # nearer to the border no detector finds a marker


@dataclass(frozen=True, slots=True)
class SeenMarker:
    """One marker: exact corners (4, 2) [px] in each eye, None where the eye does not see it whole and clear."""

    marker_id: int
    on: ObjectOn
    left_px: Array | None
    right_px: Array | None


class TrueView:
    """What both true eyes see of a world's markers. The tool's plate and shank hide what lies behind them."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._T_cam_tcp = inverse_pose(world.camera.T_tcp_cam_left)
        self._tool: list[SeenMarker] | None = None
        self._tool_px = {"left": self._tool_outlines("left"), "right": self._tool_outlines("right")}

    def corners(self, T_base_tcp: Array) -> tuple[SeenMarker, ...]:
        """Every marker from a true tool pose."""
        scene = self._world.scene
        T_cam_tool, T_cam_ooi = true_poses_cam(self._world, T_base_tcp)
        if self._tool is None:  # rigid to the camera: always the same
            self._tool = [self._seen(marker, "tool", T_cam_tool @ marker.T_on_marker) for marker in scene.tool_markers]
        seen = [self._seen(marker, "ooi", T_cam_ooi @ marker.T_on_marker) for marker in scene.ooi_markers]
        return (*self._tool, *seen)

    def _seen(self, marker: Marker, on: ObjectOn, T_cam_marker: Array) -> SeenMarker:
        points = transform_points(T_cam_marker, marker_corners(marker.side_m))
        found: dict[EyeName, Array | None] = {}
        for eye in EYES:
            camera = self._camera(eye)
            own = points if eye == "left" else points - np.array([camera.baseline_m, 0.0, 0.0])
            in_view = faces_eye(T_cam_marker[:3, 2], own.mean(axis=0)) and in_eye(camera, own, MARGIN_PX)
            pixels = self._project(eye, points) if in_view else None
            hidden = pixels is not None and on == "ooi" and any(_overlap(pixels, px) for px in self._tool_px[eye])
            found[eye] = None if hidden else pixels
        return SeenMarker(marker.marker_id, on, found["left"], found["right"])

    def _camera(self, eye: EyeName) -> StereoCamera:
        return self._world.camera.left if eye == "left" else self._world.camera.right

    def _project(self, eye: EyeName, points_cam_left: Array) -> Array:
        shift = 0.0 if eye == "left" else self._world.camera.left.baseline_m
        return project(self._camera(eye), points_cam_left - np.array([shift, 0.0, 0.0]))

    def _tool_outlines(self, eye: EyeName) -> list[Array]:
        world = self._world
        plates = [
            marker_board(world.nominal.dictionary, one, world.scene.T_tcp_tool) for one in world.scene.tool_markers
        ]
        outlines = [
            self._project(eye, transform_points(self._T_cam_tcp @ board.T_object_board, board.outline))
            for board in (*plates, *(shank_board(plate) for plate in plates))
        ]
        return [px for px in outlines if np.isfinite(px).all()]


def _overlap(a_px: Array, b_px: Array) -> bool:
    """Whether two convex polygons share area."""
    return cv2.intersectConvexConvex(a_px.astype(np.float32), b_px.astype(np.float32))[0] > 0.0


def true_poses_cam(world: World, T_base_tcp: Array) -> tuple[Array, Array]:
    """True T_cam_tool and T_cam_ooi (4, 4)."""
    T_cam_tcp = inverse_pose(world.camera.T_tcp_cam_left)
    return T_cam_tcp @ world.scene.T_tcp_tool, T_cam_tcp @ inverse_pose(T_base_tcp) @ world.scene.T_base_ooi
