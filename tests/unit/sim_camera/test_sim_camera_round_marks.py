"""Holes and rings in the rendered wall: drawn by their seed, apart, dark with depth, and where the truth has them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.targets.holes import marked_rock
from benchmarks.targets.scene import left_eye, view
from machine.camera import project, project_stereo
from machine.description import parse_machine_toml
from machine.poses import inverse_pose, transform_points
from sim_plc.camera.round_marks import MARKS_MAX, draw_marks
from sim_plc.camera.wall import wall_relief

ROOT = Path(__file__).parents[3]
MACHINE = parse_machine_toml((ROOT / "machine/machines/hiab033.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def scene():
    renderer, marks = marked_rock(MACHINE, 3, 1.0, MARKS_MAX)
    rng = np.random.default_rng(3)
    T = view(MACHINE, rng, 0.2, 0.0)
    return renderer.render_static(T, rng), marks, inverse_pose(left_eye(renderer, T))


def test_marks_are_drawn_by_their_seed_and_lie_apart() -> None:
    relief = wall_relief(3, 0.05, 0.06)
    marks = draw_marks(3, MARKS_MAX, relief)
    assert len(marks) == MARKS_MAX
    assert [m.seed for m in draw_marks(3, MARKS_MAX, relief)] == [m.seed for m in marks]
    assert draw_marks(3, 0, relief) == ()
    for i, one in enumerate(marks):
        assert one.T_ooi_mark[2, 2] > 0.9
        for other in marks[:i]:
            gap = np.linalg.norm(one.T_ooi_mark[:3, 3] - other.T_ooi_mark[:3, 3])
            assert gap > 0.5 * (one.diameter_m + other.diameter_m)


def test_a_hole_is_darker_than_its_rock_and_a_ring_has_its_paint(scene) -> None:
    (left, _), marks, T_cam_ooi = scene
    darker = []
    for mark in marks:
        T = T_cam_ooi @ mark.T_ooi_mark
        u, v = np.rint(project(MACHINE.camera, T[None, :3, 3])[0]).astype(int)
        if not (60 < u < 1220 and 60 < v < 420):
            continue
        if mark.kind == "hole":
            around = np.median(left[v - 60 : v + 60, u - 60 : u + 60])
            darker.append(float(left[v - 2 : v + 3, u - 2 : u + 3].mean()) < 0.6 * around)
        else:
            paint = np.array([[0.5 * (mark.diameter_m - mark.line_m), 0.0, 0.0]])
            x, y = np.rint(project(MACHINE.camera, transform_points(T, paint))[0]).astype(int)
            assert abs(int(left[y, x]) - mark.grey) < 60
    assert len(darker) >= 4
    assert np.mean(darker) > 0.7  # some are shallow and lit to the bottom


def test_rims_lie_where_the_truth_has_them_in_both_eyes(scene) -> None:
    images, marks, T_cam_ooi = scene
    steps = []
    for mark in marks:
        if mark.kind != "hole":
            continue
        angle = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
        circle = 0.5 * mark.diameter_m * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        for scale in (0.93, 1.07):
            both = project_stereo(MACHINE.camera, transform_points(T_cam_ooi @ mark.T_ooi_mark, circle * scale))
            greys = [
                np.median(
                    [image[int(v), int(u)] for u, v in np.rint(pixels) if 0 <= v < 420 and 0 <= u < 1280] or [np.nan]
                )
                for image, pixels in zip(images, both, strict=True)
            ]
            steps.append(greys)
    inside, outside = np.array(steps[::2]), np.array(steps[1::2])
    known = np.isfinite(inside).all(axis=1) & np.isfinite(outside).all(axis=1)
    assert known.sum() >= 3
    assert (outside[known] - inside[known]).min() > 15.0
