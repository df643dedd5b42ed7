"""Faults of a target in rendered pairs: each must be found before anything could move by it."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.targets.scene import bare_rock, left_eye, true_target, view
from benchmarks.targets.tiles import tiled_pair
from machine.camera import project
from machine.description import Machine
from machine.poses import inverse_pose
from machine.rotations import Array
from server.targets.anchor import anchor_target
from server.targets.contracts import AnchoredTarget, PatchStatus, TargetSettings
from server.targets.surface import measure_patch
from server.targets.tracking import TargetTracker
from server.vision.contracts import Image

Pair = tuple[Image, Image]
ANCHOR_M, LOOK_M = (0.6, 0.9), (0.25, 0.5)
WRONG_MM = 5.0  # a pose that is farther off than this is a wrong one
MOVED_M, COVER_M = 0.010, 0.04


@dataclass(frozen=True, slots=True)
class _Scene:
    """Where the target is in both images of a look: pixels (2, 2), px per metre, and this case's noise."""

    pixels: Array
    scale_px_m: float
    rng: np.random.Generator


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One faulty look. found: no pose was served. wrong: one was, and it was off by more than 5 mm."""

    seed: int
    kind: str
    found: bool
    wrong: bool
    reason: str


def covered(pair: Pair, scene: _Scene) -> Pair:
    """A textured sheet lies over the target."""
    half = round(COVER_M * scene.scale_px_m)
    sheet = cv2.GaussianBlur(scene.rng.integers(0, 255, (2 * half, 2 * half)).astype(np.uint8), (0, 0), 1.5)
    return _laid_over(pair, scene, np.asarray(sheet, dtype=np.uint8))


def moved(pair: Pair, scene: _Scene) -> Pair:
    """The target, and 100 mm around it, moved by 10 mm in its plane."""
    half, shift = round(0.05 * scene.scale_px_m), MOVED_M * scene.scale_px_m
    angle = scene.rng.uniform(0.0, 2.0 * np.pi)
    step = np.array([[1.0, 0.0, shift * np.cos(angle)], [0.0, 1.0, shift * np.sin(angle)]])
    out = []
    for image, pixel in zip(pair, scene.pixels, strict=True):
        gone = np.asarray(cv2.warpAffine(image, step, image.shape[::-1]), dtype=np.uint8)
        out.append(_pasted(image, gone, pixel, half))
    return out[0], out[1]


def light_switched(pair: Pair, scene: _Scene) -> Pair:
    """The light goes out but for a rest at the noise's level."""
    dark = [(0.02 * image + scene.rng.normal(3.0, 2.0, image.shape)).clip(0, 255).astype(np.uint8) for image in pair]
    return dark[0], dark[1]


def dirty_lens(pair: Pair, scene: _Scene) -> Pair:
    """Mud on the left lens over the target and what is around it."""
    left = pair[0].copy()
    blurred = np.asarray(cv2.GaussianBlur(left, (0, 0), 25.0), dtype=np.uint8)
    return _pasted(left, blurred, scene.pixels[0], round(0.08 * scene.scale_px_m)), pair[1]


def glare(pair: Pair, scene: _Scene) -> Pair:
    """Wet rock mirrors the lamp at the target."""
    out = []
    for image, pixel in zip(pair, scene.pixels, strict=True):
        bright = image.copy()
        cv2.circle(bright, (round(pixel[0]), round(pixel[1])), round(COVER_M * scene.scale_px_m), 255, -1)
        out.append(bright)
    return out[0], out[1]


FAULTS: dict[str, Callable[[Pair, _Scene], Pair]] = {
    "covered": covered,
    "moved by 10 mm": moved,
    "light switched off": light_switched,
    "dirty lens": dirty_lens,
    "glare": glare,
}
KINDS = (*FAULTS, "repeated texture", "none")


def fault_cases(machine: Machine, seed: int, settings: TargetSettings) -> list[FaultCase]:
    """Every fault once on one wall, and a look without a fault, which must give a right pose."""
    rng = np.random.default_rng([seed, 0x6661756C])
    renderer = bare_rock(machine, seed)
    T_first = view(machine, rng, float(rng.uniform(*ANCHOR_M)))
    pixel = float(rng.uniform(450.0, 830.0)), float(rng.uniform(180.0, 380.0))
    first = renderer.render_static(T_first, rng)
    patch = measure_patch(*first, machine.camera, pixel, settings)
    target = anchor_target(1, patch, *first, machine.camera, settings)
    if not isinstance(target, AnchoredTarget):
        return [FaultCase(seed, kind, True, False, f"refused at the click: {target.reason}") for kind in KINDS]
    T_ooi_cam = left_eye(renderer, T_first)
    T_ooi_target = T_ooi_cam @ true_target(renderer.relief, machine.camera, T_ooi_cam, pixel)
    T_look = view(machine, rng, float(rng.uniform(*LOOK_M)))
    look = renderer.render_static(T_look, rng)
    truth = inverse_pose(left_eye(renderer, T_look)) @ T_ooi_target
    shift = np.array([machine.camera.baseline_m, 0.0, 0.0])
    place = truth[None, :3, 3]
    pixels = np.vstack([project(machine.camera, place), project(machine.camera, place - shift)])
    scene = _Scene(pixels, machine.camera.fx_px / float(truth[2, 3]), rng)
    cases = [
        _look(target, machine, settings, seed, kind, fault(look, scene), look, truth) for kind, fault in FAULTS.items()
    ]
    cases.append(_repeated(machine, settings, seed, rng))
    cases.append(_look(target, machine, settings, seed, "none", look, look, truth))
    return cases


def _look(
    target: AnchoredTarget,
    machine: Machine,
    settings: TargetSettings,
    seed: int,
    kind: str,
    faulty: Pair,
    before: Pair,
    truth: Array,
) -> FaultCase:
    """The fault comes between two looks from one place: the tracker knows where the target was."""
    tracker = TargetTracker(target, machine.camera, settings)
    for _ in range(2):  # the second one by recognition, where the way was too far for flow
        tracker.find_target(*before)
    fix = tracker.find_target(*faulty)
    if fix.T_cam_target is None:
        return FaultCase(seed, kind, True, False, fix.reason)
    off_mm = 1e3 * float(np.linalg.norm(fix.T_cam_target[:3, 3] - truth[:3, 3]))
    return FaultCase(seed, kind, False, off_mm > WRONG_MM, f"served, {off_mm:.2f} mm off")


def _repeated(machine: Machine, settings: TargetSettings, seed: int, rng: np.random.Generator) -> FaultCase:
    """A wall of equal tiles, clicked: no disparity is the right one."""
    pair = tiled_pair(machine.camera, rng)
    pixel = float(rng.uniform(450.0, 830.0)), float(rng.uniform(180.0, 380.0))
    patch = measure_patch(*pair, machine.camera, pixel, settings)
    return FaultCase(seed, "repeated texture", patch.status is not PatchStatus.OK, patch.ok, patch.reason)


def _laid_over(pair: Pair, scene: _Scene, sheet: Image) -> Pair:
    half, out = sheet.shape[0] // 2, []
    for image, pixel in zip(pair, scene.pixels, strict=True):
        canvas = image.copy()
        u, v = round(pixel[0]), round(pixel[1])
        canvas[max(v - half, 0) : v + half, max(u - half, 0) : u + half] = sheet[
            max(half - v, 0) : max(half - v, 0) + min(v + half, image.shape[0]) - max(v - half, 0),
            max(half - u, 0) : max(half - u, 0) + min(u + half, image.shape[1]) - max(u - half, 0),
        ]
        out.append(canvas)
    return out[0], out[1]


def _pasted(image: Image, other: Image, pixel: Array, half: int) -> Image:
    out, u, v = image.copy(), round(pixel[0]), round(pixel[1])
    rows, columns = slice(max(v - half, 0), v + half), slice(max(u - half, 0), u + half)
    out[rows, columns] = other[rows, columns]
    return out
