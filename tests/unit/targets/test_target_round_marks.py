"""Boreholes and painted rings: found by both eyes, with an honest centre and axis; nothing found where none is."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from target_scenes import SETTINGS, machine, pair_at

from benchmarks.targets.holes import DIAMETERS_M, hole_cases, marked_rock, own_tool_px
from benchmarks.targets.scene import view
from server.targets.circle_fit import Circle
from server.targets.contracts import SurfacePatch
from server.targets.round_marks import find_round_marks, on_surface
from server.targets.surface import target_frame


@lru_cache
def cases():
    return hole_cases(machine(), 4, SETTINGS)


@lru_cache
def wall():
    """A wall of twelve marks, its pair at 0.6 m, and the own tool in it."""
    renderer, _ = marked_rock(machine(), 5, 0.8, 12)
    rng = np.random.default_rng(5)
    T = view(machine(), rng, 0.1, 8.0)
    return renderer.render_static(T, rng), own_tool_px(renderer)


def test_every_visible_mark_is_found_and_nothing_else() -> None:
    near = [case for case in cases() if case.near]
    assert sum(case.visible for case in near) >= 4
    assert [case for case in near if case.visible and not case.found] == []
    assert [case for case in cases() if case.kind == "false"] == []


def test_centre_and_axis_are_as_good_as_stated() -> None:
    near = [case for case in cases() if case.near and case.status == "ok"]
    assert max(case.centre_mm for case in near) < 1.0
    assert max(case.axis_deg for case in near) < 2.0
    assert max(case.chi2_centre for case in near) < 16.3  # 99.9 %, 3 degrees of freedom
    assert max(case.chi2_axis for case in near) < 13.8  # 99.9 %, 2 degrees of freedom


def test_marks_are_numbered_from_left_to_right_and_only_the_wanted_size_is_taken() -> None:
    (left, right), tool = wall()
    found = find_round_marks(left, right, machine().camera, DIAMETERS_M, SETTINGS, tool)
    assert found.reason == ""
    pixels = [mark.patch.pixel[0] for mark in found.marks]
    assert [mark.number for mark in found.marks] == list(range(1, len(pixels) + 1))
    assert pixels == sorted(pixels)
    nominal = {mark.nominal_m for mark in found.marks}
    one = find_round_marks(left, right, machine().camera, (0.045,), SETTINGS, tool)
    assert {mark.nominal_m for mark in one.marks} == {0.045}
    assert len(one.marks) == sum(mark.nominal_m == 0.045 for mark in found.marks)
    assert len(nominal) > 1


def test_plain_rock_has_no_marks() -> None:
    (left, right), _ = pair_at(0.3, 2)
    assert find_round_marks(left, right, machine().camera, DIAMETERS_M, SETTINGS).marks == ()


def test_without_a_wall_the_reason_is_given() -> None:
    dark = np.zeros((720, 1280), np.uint8)
    found = find_round_marks(dark, dark, machine().camera, (0.05,), SETTINGS)
    assert found.marks == ()
    assert "add light" in found.reason


def _surface(tilt_deg: float, height_m: float) -> SurfacePatch:
    known = cases_patch()
    normal = np.array([np.sin(np.deg2rad(tilt_deg)), 0.0, -np.cos(np.deg2rad(tilt_deg))])
    T = target_frame(normal, np.array([0.0, 0.0, 0.6 - height_m]))
    return replace(known, T_cam_target=T, covariance=np.diag([3e-3] * 3 + [3e-4] * 3) ** 2)


@lru_cache
def cases_patch() -> SurfacePatch:
    (left, right), tool = wall()
    return next(
        m.patch for m in find_round_marks(left, right, machine().camera, (0.045,), SETTINGS, tool).marks if m.patch.ok
    )


def test_the_surface_around_sharpens_a_rim_and_a_contradicting_one_does_not_count() -> None:
    circle = Circle(np.array([0.0, 0.0, 0.6]), np.array([0.0, 0.0, -1.0]), 0.0225)
    C = np.diag([1e-2] * 3 + [5e-4, 5e-4, 1e-3]) ** 2
    axis, centre, together = on_surface(circle, C, _surface(0.5, 0.0005), 1e-4)
    assert 0.3 < np.rad2deg(np.arcsin(axis[0])) < 0.5
    assert 0.0002 < 0.6 - centre[2] < 0.0005
    assert together[0, 0] < 0.2 * C[0, 0]
    assert together[5, 5] < 0.2 * C[5, 5]
    for wrong in (_surface(8.0, 0.0), _surface(0.0, 0.02)):
        axis, centre, alone = on_surface(circle, C, wrong, 1e-4)
        assert np.array_equal(alone, C)
        assert centre == pytest.approx(circle.centre)
