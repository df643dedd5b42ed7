"""The crane's own structure in the picture: two beams and the housing behind the tool, fixed to it, and two hoses.

Axes are the tcp's: x up, y to the left, z back towards the wrist. The beams end where the wanted share of the picture
is covered. The hoses have a constant length between a clamp on the boom, before the wrist, and one at the tool.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from machine.camera import project
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array
from sim_plc.camera.boards import Board
from sim_plc.camera.eye import EyeRays, projectable_mask
from sim_plc.camera.hose import HoseInEye
from sim_plc.camera.texture import Grey, value_noise

if TYPE_CHECKING:
    from sim_plc.world import StructureTruth

WRIST_CENTRE_TCP_M = np.array([0.0, 0.0, 0.55])  # wrist centre, nominal
_BOOM_REST_TCP = np.array([0.6, 0.0, 0.8])  # wrist to elbow with the wrist bent by 37 deg: where the cover is measured
_DOWN_REST_TCP = np.array([-1.0, 0.0, 0.0])  # tool level

_CELL_M = 0.001  # of the painted texture: about one pixel at half a metre
_BEAM_GREY, _HOUSING_GREY, _HOSE_GREY = 96, 62, 46
_TEXTURE_GREY = 34.0  # standard deviation at full contrast, as rusty, scratched paint
_SCRATCHES_M2, _BOLT_STEP = 600, 80  # scratches per square metre; cells from bolt to bolt
_SHADE = {"x": 1.0, "y": 0.72, "z": 0.86}  # of a face by its normal: lit from above
_BOTTOM_M, _BEHIND_M = -0.55, 0.70  # where boxes end out of view
_BEAM_INNER_M, _BEAM_OUTER_M, _BEAM_FRONT_M = 0.32, 0.64, 0.06
_BEAM_TOP_M, _LEFT_RISE_M, _RIGHT_RISE_M = -0.12, 0.67, 0.55  # lowest, and how far the wanted cover may raise it

HOSE_RADIUS_M = 0.013
_HOSE_LENGTH_M = 0.86
_BOOM_CLAMP_M = 0.25  # from the wrist centre along the boom
_BOOM_CLAMP_SIDE_M = 0.16
_TOOL_CLAMP_TCP_M = np.array([-0.09, 0.305, 0.08])  # of the left hose, at its beam; the right one mirrors it
_BULGE_TCP = np.array([1.0, 0.15, 0.0])  # a stiff hose arches up, away from its clamps
_BULGE_DOWN = 0.25  # and sags
_N_POINTS = 40
_HOSE_ROWS_M, _HOSE_COLUMNS = 0.001, 48  # of its texture, along and around
_FIT_STEPS = 12  # halvings of the beams' size: 1 part in 4000


def _box_faces(low: Array, high: Array, grey: int, contrast_frac: float, rng: np.random.Generator) -> tuple[Board, ...]:
    """Six faces of a box between two corners, printed sides out; `contrast_frac` 0: plain, one cell each."""
    middle, size = 0.5 * (low + high), high - low
    faces = []
    for axis, name in enumerate("xyz"):
        for sign in (-1.0, 1.0):
            z = sign * np.eye(3)[axis]
            x = np.eye(3)[(axis + 1) % 3]
            y = np.cross(z, x)
            width, height = size[(axis + 1) % 3], size[(axis + 2) % 3]
            tone = grey * _SHADE[name]
            cells = steel_cells(width, height, tone, contrast_frac, rng)
            T_tcp_face = pose(np.stack([x, y, z], axis=1), middle + 0.5 * size[axis] * z)
            faces.append(Board(cells, width / cells.shape[1], height / cells.shape[0], T_tcp_face))
    return tuple(faces)


def steel_cells(width_m: float, height_m: float, grey: float, contrast_frac: float, rng: np.random.Generator) -> Grey:
    """Painted steel: rust and dirt at several scales, scratches and bolts; one plain cell without contrast."""
    if contrast_frac == 0.0:
        return np.full((1, 1), round(grey), np.uint8)
    cols, rows = round(width_m / _CELL_M), round(height_m / _CELL_M)
    field = np.zeros((rows, cols), np.float32)
    for spot_m, gain in ((0.1, 1.0), (0.03, 0.8), (0.01, 0.7), (0.004, 0.5)):
        spots = rng.standard_normal((round(height_m / spot_m), round(width_m / spot_m)), np.float32)
        field += gain * np.asarray(cv2.resize(spots, (cols, rows), interpolation=cv2.INTER_CUBIC))
    for _ in range(round(_SCRATCHES_M2 * width_m * height_m)):
        start = rng.uniform((0, 0), (cols, rows))
        ends = np.rint(np.stack([start, start + rng.normal(0.0, 40.0, 2)])).astype(np.int32)
        cv2.polylines(field, [ends], False, float(rng.normal(0.0, 3.0)), 2)
    for v in range(_BOLT_STEP // 3, rows, _BOLT_STEP):
        for u in range(_BOLT_STEP // 3, cols, _BOLT_STEP):
            cv2.circle(field, (u, v), 9, 2.5, -1)
            cv2.circle(field, (u, v), 5, -2.5, -1)
    field *= np.float32(contrast_frac * _TEXTURE_GREY / field.std())
    return np.clip(field + grey, 4.0, 250.0).astype(np.uint8)


def hose_skin(contrast_frac: float, rng: np.random.Generator) -> Grey:
    """Rubber as it is seen, rows along, columns across: shaded round; with contrast: dirt, and the maker's print.

    The print is a light broken line along the middle, as letters are.
    """
    across = (np.arange(_HOSE_COLUMNS) + 0.5) / _HOSE_COLUMNS * 2.0 - 1.0
    rows = round(_HOSE_LENGTH_M / _HOSE_ROWS_M) + 1
    skin = np.repeat(_HOSE_GREY * (0.35 + 0.65 * np.sqrt(1.0 - across**2))[None], rows, axis=0)
    if contrast_frac > 0.0:
        letters = cv2.GaussianBlur((rng.random((rows, 4)) < 0.5).astype(np.float32), (1, 3), 0.0)
        skin += contrast_frac * 12.0 * value_noise(rng, rows, _HOSE_COLUMNS, rows // 8, _HOSE_COLUMNS // 8)
        skin[:, 22:26] += contrast_frac * 110.0 * np.asarray(letters)
    return np.clip(skin, 4.0, 250.0).astype(np.uint8)


def _beam_and_housing_faces(share: float, contrast_frac: float, seed: int) -> tuple[Board, ...]:
    """Faces of beams and housing, which never hide each other from between the beams; `share` 0..1 raises the beams."""
    rng = np.random.default_rng([seed, 0x626F6F6D])

    def box(tops_m: float, sides_m: tuple[float, float], ends_m: tuple[float, float], grey: int) -> tuple[Board, ...]:
        low, high = np.array([_BOTTOM_M, sides_m[0], ends_m[0]]), np.array([tops_m, sides_m[1], ends_m[1]])
        return _box_faces(low, high, grey, contrast_frac, rng)

    beam = (_BEAM_FRONT_M, _BEHIND_M)
    left = box(_BEAM_TOP_M + _LEFT_RISE_M * share, (_BEAM_INNER_M, _BEAM_OUTER_M), beam, _BEAM_GREY)
    right = box(_BEAM_TOP_M + _RIGHT_RISE_M * share, (-_BEAM_OUTER_M, -_BEAM_INNER_M), beam, _BEAM_GREY)
    return left + right + box(-0.05, (-0.08, 0.08), (0.13, 0.45), _HOUSING_GREY)


def hose_curves(boom_tcp: Array, down_tcp: Array) -> tuple[Array, Array]:
    """Centre lines (n, 3) [m] of the left and right hose, in tcp axes, from the boom to the tool.

    Model:   a parabola of constant length between the clamps; with chord c and length L its bulge is
             b = sqrt(3 c (L - c) / 8), upward and outward as its clamps point, less what its weight takes.
    Args:    boom_tcp: unit vector from the wrist centre to the elbow. down_tcp: unit vector of gravity.
    """
    t = np.linspace(0.0, 1.0, _N_POINTS)[:, None]
    side = np.array([0.0, 1.0, 0.0]) - boom_tcp[1] * boom_tcp  # to the left, across the boom
    side = side / max(float(np.linalg.norm(side)), 1e-6)
    curves = []
    for sign in (1.0, -1.0):
        start = WRIST_CENTRE_TCP_M + _BOOM_CLAMP_M * boom_tcp + sign * _BOOM_CLAMP_SIDE_M * side
        end = _TOOL_CLAMP_TCP_M * [1.0, sign, 1.0]
        chord = float(np.linalg.norm(end - start))
        bulge_m = np.sqrt(max(0.0, 3.0 * chord * (_HOSE_LENGTH_M - chord) / 8.0))
        towards = _BULGE_TCP * [1.0, sign, 1.0] + _BULGE_DOWN * down_tcp
        bulge = 4.0 * t * (1.0 - t) * bulge_m * towards / np.linalg.norm(towards)
        curves.append((1.0 - t) * start + t * end + bulge)
    return curves[0], curves[1]


def hoses_at(truth: "StructureTruth", T_base_tcp: Array) -> tuple[Array, Array]:
    """The hoses' centre lines at one pose of the tool; at rest they hang as with the tool level."""
    if not truth.hoses_move:
        return hose_curves(_BOOM_REST_TCP, _DOWN_REST_TCP)
    R, wrist = T_base_tcp[:3, :3], transform_points(T_base_tcp, WRIST_CENTRE_TCP_M[None])[0]
    boom = R.T @ (truth.elbow_base_m - wrist)
    return hose_curves(boom / max(float(np.linalg.norm(boom)), 1e-6), R.T @ truth.down_base)


def hose_in_eye(rays: EyeRays, T_tcp_cam: Array, curve_tcp: Array) -> HoseInEye | None:
    """One hose's centre line in one eye's picture, from the tool on; None when it is out of the lens's sight."""
    T_cam_tcp = inverse_pose(T_tcp_cam)
    points = transform_points(T_cam_tcp, curve_tcp)[::-1]
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    n_seen = len(points) if np.all(seen := projectable_mask(points)) else int(np.argmin(seen))
    if n_seen < 2:
        return None
    points, lengths = points[:n_seen], lengths[:n_seen]
    pixels = project(rays.camera, points)
    return HoseInEye(pixels, rays.camera.fx_px * HOSE_RADIUS_M / points[:, 2], lengths / _HOSE_ROWS_M)


def backs_first(boards: Sequence[Board], T_tcp_cam: Array) -> list[Board]:
    """Faces of closed boxes in painter's order: those behind shut the seams between those that the camera sees."""
    return sorted(boards, key=lambda board: (inverse_pose(board.T_object_board) @ T_tcp_cam)[2, 3] > 0.0)


def _rays_hitting_board(rays: Array, board: Board, T_tcp_cam: Array) -> NDArray[np.bool_]:
    """Which rays (n, 2) meet a board."""
    T = inverse_pose(board.T_object_board) @ T_tcp_cam
    directions = np.column_stack([rays, np.ones(len(rays))]) @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -T[2, 3] / directions[:, 2]
        places = T[:2, 3] + t[:, None] * directions[:, :2]
    return np.asarray((t > 0.0) & np.all(np.abs(places) < board.outline[1, :2], axis=1))


def _share_at(share: float, eyes: "Sequence[tuple[EyeRays, Array]]", hidden: "Sequence[NDArray[np.bool_]]") -> float:
    """Covered share of both pictures, at the sparse rays inside them; `hidden`: by hoses and tool."""
    covered = 0.0
    boards = _beam_and_housing_faces(share, 0.0, 0)
    for (rays, T_tcp_cam), already in zip(eyes, hidden, strict=True):
        nodes = rays.node_rays[1:-2, 1:-2].reshape(-1, 2)
        hit = already.ravel().copy()
        for board in boards:
            hit |= _rays_hitting_board(nodes, board, T_tcp_cam)
        covered += float(hit.mean()) / len(eyes)
    return covered


def structure_faces(
    truth: "StructureTruth", seed: int, eyes: "Sequence[tuple[EyeRays, Array]]", hidden: "Sequence[NDArray[np.bool_]]"
) -> tuple[Board, ...]:
    """Faces of housing and beams that, with all else, cover `truth.cover_frac` of the pictures, as nearly as they can.

    Args:    seed: of the paint. eyes: rays and T_tcp_cam of each. hidden: pixels at the sparse rays (every
             `step_px`) that hoses and tool cover already, per eye.
    """
    low, high = 0.0, 1.0
    for _ in range(_FIT_STEPS):
        middle = 0.5 * (low + high)
        if _share_at(middle, eyes, hidden) < truth.cover_frac:
            low = middle
        else:
            high = middle
    return _beam_and_housing_faces(0.5 * (low + high), truth.contrast_frac, seed)
