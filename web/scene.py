"""The 3D scene: viser, fed with frozen views; it holds no command and may die without taking the page along."""

import io
from itertools import pairwise

import cv2
import numpy as np
import viser
import yourdfpy
from viser.extras import ViserUrdf

from machine.chain import Chain, chain_of
from machine.description import Machine
from machine.kinematics import tcp_poses
from machine.markers import object_corners
from machine.rotations import Array, quat_wxyz_from_rotation
from machine.urdf import urdf_text
from web.scene_view import PlanShown, SceneView

LIVE_COLOR = (0.93, 0.66, 0.15, 1.0)
GHOST_COLOR = (0.25, 0.55, 0.95, 0.35)
PATH_COLOR = (30, 110, 220)
WALL_SIZE_M = 2.4
STILL_RAD = 2e-4
TRACK_COLOR = (200, 60, 160)
ENVELOPE_COLOR = (170, 180, 186)
LIMIT_COLOR = (190, 60, 40)
ELLIPSOID_COLOR = (40, 170, 120)
ELLIPSOID_TIMES = 10.0  # two sigma, drawn ten times as large: a few millimetres would not be seen


# Lines that show what the machine can reach: the outline of the tool's reach in its own plane, and the slew's ends.

GRID = 13
SECTORS = 36
CLEAR_M = 0.02  # above the floor


def reach_segments(chain: Chain) -> Array:
    """A circle on the floor at the furthest reach, and the outline of the reach upright, slew in the middle.

    Returns: segments (k, 2, 3) [m, base].
    """
    points = _reachable_tcp_points(chain)
    radius = np.hypot(points[:, 0], points[:, 1])
    rim = _arc_segments(float(radius.max()), float(chain.q_min[0]), float(chain.q_max[0]))
    return np.concatenate([rim, _reach_outline_segments(radius, points[:, 2], _slew_middle(chain))])


def slew_limits(chain: Chain) -> Array:
    """Two lines on the floor from the base to the reach, at both ends of the first joint (2, 2, 3) [m, base]."""
    points = _reachable_tcp_points(chain)
    radius = float(np.hypot(points[:, 0], points[:, 1]).max())
    ends = [np.array([radius * np.cos(q), radius * np.sin(q), CLEAR_M]) for q in (chain.q_min[0], chain.q_max[0])]
    return np.array([[[0.0, 0.0, CLEAR_M], end] for end in ends])


def _slew_middle(chain: Chain) -> float:
    return 0.5 * float(chain.q_min[0] + chain.q_max[0])


def _reachable_tcp_points(chain: Chain) -> Array:
    """TCP positions (k, 3) over a grid of the second and third joint, the others in their middle."""
    q_mid = 0.5 * (chain.q_min + chain.q_max)
    lift, tilt = (np.linspace(chain.q_min[i], chain.q_max[i], GRID) for i in (1, 2))
    qs = np.tile(q_mid, (GRID * GRID, 1))
    qs[:, 1], qs[:, 2] = (values.ravel() for values in np.meshgrid(lift, tilt))
    return tcp_poses(chain, qs)[:, :3, 3]


def _arc_segments(radius: float, start: float, end: float) -> Array:
    angles = np.linspace(start, end, SECTORS + 1)
    rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full_like(angles, CLEAR_M)])
    return np.array(list(pairwise(rim)))


def _reach_outline_segments(radius: Array, height: Array, azimuth: float) -> Array:
    """The outermost point of each sector about the middle of the reach, joined."""
    middle = np.array([radius.mean(), height.mean()])
    away = np.column_stack([radius, height]) - middle
    sector = ((np.arctan2(away[:, 1], away[:, 0]) + np.pi) / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS
    length = np.linalg.norm(away, axis=1)
    outer = [
        int(np.flatnonzero(sector == s)[length[sector == s].argmax()]) for s in range(SECTORS) if (sector == s).any()
    ]
    rim = np.array([[radius[i] * np.cos(azimuth), radius[i] * np.sin(azimuth), max(CLEAR_M, height[i])] for i in outer])
    return np.array(list(pairwise([*rim, rim[0]])))


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
        self._live = ViserUrdf(
            self._server, _load_urdf(text), root_node_name="/machine", mesh_color_override=LIVE_COLOR
        )
        self._ghost = ViserUrdf(
            self._server, _load_urdf(text), root_node_name="/ghost", mesh_color_override=GHOST_COLOR
        )
        self._ghost_root = scene.add_frame("/ghost", show_axes=False, visible=False)
        camera = self._machine.camera
        fov = 2.0 * np.arctan2(camera.height_px / 2.0, camera.fy_px)
        aspect = camera.width_px / camera.height_px
        self._frustum = scene.add_camera_frustum(
            "/camera", fov=float(fov), aspect=aspect, scale=0.25, color=(60, 60, 60)
        )
        self._tool = scene.add_frame("/tool", axes_length=0.12, axes_radius=0.004)
        self._ooi = scene.add_frame("/ooi", axes_length=0.15, axes_radius=0.005, visible=False)
        self._ellipsoid = scene.add_icosphere(
            "/error", radius=1.0, color=ELLIPSOID_COLOR, opacity=0.45, visible=False, cast_shadow=False
        )
        self._add_envelope()
        wall = (WALL_SIZE_M, WALL_SIZE_M, 0.02)
        scene.add_box("/ooi/wall", dimensions=wall, position=(0.0, 0.0, -0.07), color=(150, 145, 138), opacity=0.5)
        self._add_markers()

    def _add_envelope(self) -> None:
        """How far the tool reaches, and where slewing ends."""
        chain = chain_of(self._machine)
        reach, ends = reach_segments(chain), slew_limits(chain)
        self._server.scene.add_line_segments("/envelope", points=reach, colors=ENVELOPE_COLOR, thickness=0.006)
        self._server.scene.add_line_segments("/slew_limits", points=ends, colors=LIMIT_COLOR, thickness=0.014)

    def _add_markers(self) -> None:
        scene = self._server.scene
        machine = self._machine
        for markers, root in ((machine.markers_on("ooi"), "/ooi"), (machine.markers_on("tool"), "/tool")):
            for marker_id, corners in object_corners(markers).items():
                segments = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
                name = f"{root}/marker_{marker_id}"
                scene.add_line_segments(name, points=segments, colors=(15, 15, 15), thickness=0.008)

    def update_scene(self, view: SceneView) -> None:
        """Bring the scene up to date, as one consistent frame; a view that shows nothing new costs nothing."""
        before = self._shown
        if view.picture_jpeg is not None:
            self._show_picture(view.picture_jpeg)
        if before is not None and _is_visually_same(view, before):
            return
        with self._server.atomic():
            self._live.update_cfg(np.array(view.q_rad))
            _set_node_pose(self._frustum, view.T_base_cam)
            _set_node_pose(self._tool, view.T_base_tool)
            self._ooi.visible = view.T_base_ooi is not None
            if view.T_base_ooi is not None:
                _set_node_pose(self._ooi, view.T_base_ooi)
            if before is None or _plan_name(view) != _plan_name(before):
                self._show_plan(view.plan)
            if view.plan is not None:
                self._show_on_path(view.plan, view.scrub_frac)
            if before is None or not _is_same_array(view.track_base_m, before.track_base_m):
                self._show_track(view.track_base_m)
            if before is None or not _is_same_array(view.map_base_m, before.map_base_m):
                self._show_map(view.map_base_m)
        self._shown = view

    def _show_plan(self, plan: PlanShown | None) -> None:
        self._ghost_root.visible = self._ellipsoid.visible = plan is not None
        if plan is None or len(plan.path_base_m) < 2:
            self._server.scene.remove_by_name("/path")
            return
        segments = np.stack([plan.path_base_m[:-1], plan.path_base_m[1:]], axis=1)
        self._server.scene.add_line_segments("/path", points=segments, colors=PATH_COLOR, thickness=0.012)
        _set_node_pose(self._ellipsoid, plan.T_base_ellipsoid)
        x, y, z = ELLIPSOID_TIMES * plan.ellipsoid_radii_m
        self._ellipsoid.scale = (float(x), float(y), float(z))

    def _show_on_path(self, plan: PlanShown, frac: float) -> None:
        """The ghost where the scrubber stands."""
        index = round(frac * (len(plan.qs_rad) - 1))
        self._ghost.update_cfg(plan.qs_rad[index])

    def _show_track(self, track_base_m: Array | None) -> None:
        if track_base_m is None or len(track_base_m) < 2:
            self._server.scene.remove_by_name("/odometry")
            return
        segments = np.stack([track_base_m[:-1], track_base_m[1:]], axis=1)
        self._server.scene.add_line_segments("/odometry", points=segments, colors=TRACK_COLOR, thickness=0.008)

    def _show_map(self, map_base_m: Array | None) -> None:
        if map_base_m is None or len(map_base_m) == 0:
            self._server.scene.remove_by_name("/odometry_map")
            return
        points = np.asarray(map_base_m, np.float32)
        self._server.scene.add_point_cloud("/odometry_map", points=points, colors=TRACK_COLOR, point_size=0.008)

    def _show_picture(self, jpeg: bytes) -> None:
        """The newest picture, small, in the frustum."""
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_REDUCED_COLOR_8)
        if image is not None:
            self._frustum.image = np.ascontiguousarray(image[:, :, ::-1])


def _is_visually_same(a: SceneView, b: SceneView) -> bool:
    """Whether no viewer could see a difference: an encoder that flickers must not redraw every viewer's screen."""
    turned = max(abs(x - y) for x, y in zip(a.q_rad, b.q_rad, strict=True))
    moved = float(np.abs(a.T_base_cam - b.T_base_cam).max())
    way = _is_same_array(a.track_base_m, b.track_base_m) and _is_same_array(a.map_base_m, b.map_base_m)
    rest = _is_same_array(a.T_base_ooi, b.T_base_ooi) and way
    plan = _plan_name(a) == _plan_name(b) and a.scrub_frac == b.scrub_frac
    return turned < STILL_RAD and moved < STILL_RAD and rest and plan


def _is_same_array(a: Array | None, b: Array | None) -> bool:
    return (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))


def _plan_name(view: SceneView) -> str:
    return "" if view.plan is None else view.plan.name


def _load_urdf(text: str) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(io.StringIO(text))


def _set_node_pose(node: viser.SceneNodeHandle, T_base_node: Array) -> None:
    node.position = T_base_node[:3, 3]
    node.wxyz = quat_wxyz_from_rotation(T_base_node[:3, :3])
