"""The 3D scene: viser, fed with frozen views; it holds no command and may die without taking the page along."""

import io
from dataclasses import dataclass

import numpy as np
import viser
import yourdfpy
from viser.extras import ViserUrdf

from machine.description import Machine
from machine.markers import object_corners
from machine.rotations import Array, quat_wxyz_from_rotation
from machine.urdf import urdf_text

LIVE_COLOR = (0.93, 0.66, 0.15, 1.0)
GHOST_COLOR = (0.25, 0.55, 0.95, 0.35)
PATH_COLOR = (30, 110, 220)
WALL_SIZE_M = 2.4
STILL_RAD = 2e-4


@dataclass(frozen=True, slots=True)
class SceneView:
    """What the scene shows: joints [rad], the machine's tcp and camera, the OOI if known, the previewed plan if any."""

    q_rad: tuple[float, ...]
    T_base_cam: Array
    T_base_tool: Array
    T_base_ooi: Array | None
    q_goal_rad: tuple[float, ...] | None
    path_base_m: Array | None  # (m, 3)


class Scene:
    """One viser server on a loopback port of its own."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")
        self._server.gui.main_panel.minimize()
        self._build()
        self._shown: SceneView | None = None

    @property
    def port(self) -> int:
        """The loopback port that viser took."""
        return self._server.get_port()

    def close(self) -> None:
        """End viser's thread."""
        self._server.stop()

    def _build(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.add_grid("/floor", width=12.0, height=12.0, cell_size=0.5, position=(2.0, 0.0, 0.0))
        self._server.initial_camera.position = (1.1, -4.4, 2.6)
        self._server.initial_camera.look_at = (2.0, 0.0, 1.35)
        text = urdf_text(self._machine)
        self._live = ViserUrdf(self._server, _urdf(text), root_node_name="/machine", mesh_color_override=LIVE_COLOR)
        self._ghost = ViserUrdf(self._server, _urdf(text), root_node_name="/ghost", mesh_color_override=GHOST_COLOR)
        self._ghost_root = scene.add_frame("/ghost", show_axes=False, visible=False)
        camera = self._machine.camera
        fov = 2.0 * np.arctan2(camera.height_px / 2.0, camera.fy_px)
        aspect = camera.width_px / camera.height_px
        self._frustum = scene.add_camera_frustum(
            "/camera", fov=float(fov), aspect=aspect, scale=0.25, color=(60, 60, 60)
        )
        self._tool = scene.add_frame("/tool", axes_length=0.12, axes_radius=0.004)
        self._ooi = scene.add_frame("/ooi", axes_length=0.15, axes_radius=0.005, visible=False)
        wall = (WALL_SIZE_M, WALL_SIZE_M, 0.02)
        scene.add_box("/ooi/wall", dimensions=wall, position=(0.0, 0.0, -0.07), color=(150, 145, 138), opacity=0.5)
        self._add_markers()

    def _add_markers(self) -> None:
        scene = self._server.scene
        machine = self._machine
        for markers, root in ((machine.markers_on("ooi"), "/ooi"), (machine.markers_on("tool"), "/tool")):
            for marker_id, corners in object_corners(markers).items():
                segments = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
                name = f"{root}/marker_{marker_id}"
                scene.add_line_segments(name, points=segments, colors=(15, 15, 15), thickness=0.008)

    def show(self, view: SceneView) -> None:
        """Bring the scene up to date, as one consistent frame; a view that shows nothing new costs nothing."""
        if self._shown is not None and _same(view, self._shown):
            return
        with self._server.atomic():
            self._live.update_cfg(np.array(view.q_rad))
            _place(self._frustum, view.T_base_cam)
            _place(self._tool, view.T_base_tool)
            self._ooi.visible = view.T_base_ooi is not None
            if view.T_base_ooi is not None:
                _place(self._ooi, view.T_base_ooi)
            if self._shown is None or view.q_goal_rad != self._shown.q_goal_rad:
                self._show_plan(view)
        self._shown = view

    def _show_plan(self, view: SceneView) -> None:
        self._ghost_root.visible = view.q_goal_rad is not None
        if view.q_goal_rad is None or view.path_base_m is None or len(view.path_base_m) < 2:
            self._server.scene.remove_by_name("/path")
            return
        self._ghost.update_cfg(np.array(view.q_goal_rad))
        segments = np.stack([view.path_base_m[:-1], view.path_base_m[1:]], axis=1)
        self._server.scene.add_line_segments("/path", points=segments, colors=PATH_COLOR, thickness=0.012)


def _same(a: SceneView, b: SceneView) -> bool:
    """Whether nobody could see a difference: an encoder that flickers must not redraw every viewer's screen."""
    turned = max(abs(x - y) for x, y in zip(a.q_rad, b.q_rad, strict=True))
    moved = float(np.abs(a.T_base_cam - b.T_base_cam).max())
    ooi = a.T_base_ooi is b.T_base_ooi
    return turned < STILL_RAD and moved < STILL_RAD and ooi and a.q_goal_rad == b.q_goal_rad


def _urdf(text: str) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(io.StringIO(text))


def _place(node: viser.SceneNodeHandle, T_base_node: Array) -> None:
    node.position = T_base_node[:3, 3]
    node.wxyz = quat_wxyz_from_rotation(T_base_node[:3, :3])
