"""The crane's own structure in both eyes: fixed parts painted once, hoses in every image."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.description import StereoCamera
from machine.poses import pose
from machine.rotations import Array
from sim_plc.camera.boards import Board, paint_board
from sim_plc.camera.eye import EyeRays, eye_rays
from sim_plc.camera.hose import paint_hose
from sim_plc.camera.structure import backs_first, hose_in_eye, hose_skin, hoses_at, structure_faces
from sim_plc.camera.texture import Grey

# What is fixed to the camera: painted once, laid over every picture.


@dataclass(frozen=True, slots=True)
class FixedPatch:
    """Boards as one eye always sees them: picture = own_grey + see_through * what lies behind."""

    roi_px: tuple[int, int, int, int]  # u0, v0, u1, v1
    own_grey: NDArray[np.float32]
    see_through: NDArray[np.float32]


def fixed_patch(rays: EyeRays, boards: Sequence[Board], T_tcp_cam: Array) -> FixedPatch | None:
    """The boards, far to near, over black and over white give ink and cover; None when the eye does not see them."""
    shape = (rays.camera.height_px, rays.camera.width_px)
    black, white = np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)
    keys = np.repeat(T_tcp_cam[None], 2, axis=0)
    for board in boards:
        paint_board(black, rays, board, keys)
        paint_board(white, rays, board, keys)
    see_through = (white.astype(np.float32) - black) / np.float32(255.0)
    v, u = np.nonzero(see_through < 1.0)
    if v.size == 0:
        return None
    roi = int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1
    window = np.s_[roi[1] : roi[3], roi[0] : roi[2]]
    return FixedPatch(roi, black[window].astype(np.float32), see_through[window].copy())


def paint_patch(image: Grey, patch: FixedPatch) -> None:
    """Lay it over a picture, in place."""
    u0, v0, u1, v1 = patch.roi_px
    _lay_over(image[v0:v1, u0:u1], patch.own_grey, patch.see_through)


@njit(cache=True, nogil=True)
def _lay_over(window: Grey, ink: NDArray[np.float32], see_through: NDArray[np.float32]) -> None:
    for v in range(window.shape[0]):
        for u in range(window.shape[1]):
            if see_through[v, u] < np.float32(1.0):
                grey = ink[v, u] + see_through[v, u] * np.float32(window[v, u])
                window[v, u] = np.uint8(grey + np.float32(0.5))


if TYPE_CHECKING:
    from sim_plc.world import CameraTruth, StructureTruth

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class EyeView:
    """One eye, and the tool as it sees it."""

    rays: EyeRays
    T_tcp_cam: Array
    tool_patch: FixedPatch | None


@lru_cache(maxsize=4)
def _camera_rays(camera: StereoCamera) -> EyeRays:
    return eye_rays(camera)


def eye_views(camera: "CameraTruth", tool_boards: tuple[Board, ...]) -> tuple[EyeView, EyeView]:
    """Left and right eye with the tool in view."""

    def view(eye: StereoCamera, T_tcp_cam: Array) -> EyeView:
        rays = _camera_rays(eye)
        return EyeView(rays, T_tcp_cam, fixed_patch(rays, tool_boards, T_tcp_cam))

    T_left_right = pose(np.eye(3), np.array([camera.left.baseline_m, 0.0, 0.0]))
    return view(camera.left, camera.T_tcp_cam_left), view(camera.right, camera.T_tcp_cam_left @ T_left_right)


class OwnStructure:
    """Beams, housing, hoses and tool of one crane in front of its camera; without a truth only the tool."""

    def __init__(self, truth: "StructureTruth | None", seed: int, eyes: tuple[EyeView, EyeView]) -> None:
        """Fits the beams to the wanted cover, with the hoses at rest. `seed`: of the paint."""
        self._eyes, self._truth = eyes, truth
        self._fixed: tuple[FixedPatch | None, ...] = (None, None)
        self.boards: tuple[Board, ...] = ()  # faces of beams and housing, in tcp axes
        if truth is None:
            return
        self._skin = hose_skin(truth.contrast_frac, np.random.default_rng([seed, 0x686F7365]))
        step, resting = eyes[0].rays.step_px, replace(truth, hoses_move=False)
        hidden = [_own_structure_mask(eye, None, resting, np.eye(4))[::step, ::step] for eye in eyes]
        self.boards = structure_faces(truth, seed, [(eye.rays, eye.T_tcp_cam) for eye in eyes], hidden)
        self._fixed = tuple(
            fixed_patch(eye.rays, backs_first(self.boards, eye.T_tcp_cam), eye.T_tcp_cam) for eye in eyes
        )

    def paint(self, image: Grey, eye: int, T_base_tcp: Array) -> None:
        """Lay everything over one eye's picture (0 left, 1 right), in place; the tool last, it is never hidden."""
        view, fixed = self._eyes[eye], self._fixed[eye]
        if fixed is not None:
            paint_patch(image, fixed)
        if self._truth is not None:
            _paint_hoses(image, view, self._truth, T_base_tcp, self._skin)
        if view.tool_patch is not None:
            paint_patch(image, view.tool_patch)

    def own_masks(self, T_base_tcp: Array) -> tuple[Mask, Mask]:
        """Where own structure, tool included, covers at least half of a pixel: left, right; (height, width) bool.

        The simulation's truth, for tests and benches.
        """
        left, right = (
            _own_structure_mask(eye, fixed, self._truth, T_base_tcp)
            for eye, fixed in zip(self._eyes, self._fixed, strict=True)
        )
        return left, right


def _paint_hoses(image: Grey, view: EyeView, truth: "StructureTruth", T_base_tcp: Array, skin: Grey) -> None:
    for curve in hoses_at(truth, T_base_tcp):
        hose = hose_in_eye(view.rays, view.T_tcp_cam, curve)
        if hose is not None:
            paint_hose(image, hose.centre_line_px, hose.radius_px, hose.skin_row, skin)


def _own_structure_mask(
    view: EyeView, fixed: FixedPatch | None, truth: "StructureTruth | None", T_base_tcp: Array
) -> Mask:
    cover = np.zeros((view.rays.camera.height_px, view.rays.camera.width_px), np.uint8)
    if truth is not None:
        _paint_hoses(cover, view, truth, T_base_tcp, np.full((2, 1), 255, np.uint8))
    mask = np.asarray(cover > 127)
    for patch in (fixed, view.tool_patch):
        if patch is not None:
            u0, v0, u1, v1 = patch.roi_px
            mask[v0:v1, u0:u1] |= patch.see_through < 0.5
    return mask
