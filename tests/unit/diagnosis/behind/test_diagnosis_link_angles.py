"""Link-side angles between logged rows: as numpy interpolates, joint by joint as all joints at once."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML

from diagnosis.behind.link_angles import Path, link_angles
from machine.description import parse_machine_toml
from machine.effects import kernel
from machine.effects.dynamics import actuators_of, drive_joint, simulate
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets, neutral_sets

PLANT = replace(actuators_of(parse_machine_toml(MACHINE_TOML)), cycle_s=0.01, log_cycle_s=0.01)
N = PLANT.n


def path(start_s: float, step_s: float | None = PLANT.cycle_s) -> Path:
    t = start_s + 0.01 * np.arange(400)
    phases = np.arange(N)
    return Path(t, np.ascontiguousarray(0.3 * np.sin(2.0 * t[:, None] + phases)), step_s)


PATHS = (path(0.0), path(10.0))
TIMES = np.array([0.0, 0.0131, 1.2, 3.99, 10.0, 12.34567, 13.98, 20.0])
AT = np.array([0, 0, 0, 0, 1, 1, 1, 1])


def loose(joints: tuple[int, ...]) -> ParameterSets:
    sets = neutral_sets(N)
    sets.joint_parameters[0, :, kernel.BIAS], sets.joint_parameters[0, :, kernel.SCALE] = 1e-3, 1e-3
    for j in joints:
        sets.joint_parameters[0, j, kernel.BACKLASH] = 2e-3
    return sets


def between(times_s: np.ndarray, t_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows (k, n) at other times (m, n): the polynomial through the four nearest, held beyond the ends."""
    out = []
    for time_s in np.clip(times_s, t_s[0], t_s[-1]):
        first = int(np.clip(np.searchsorted(t_s, time_s, side="right") - 2, 0, len(t_s) - 4))
        four = slice(first, first + 4)
        out.append([np.polyval(np.polyfit(t_s[four] - time_s, column[four], 3), 0.0) for column in rows.T])
    return np.array(out)


def test_without_play_the_encoders_tell() -> None:
    found = link_angles(PATHS, loose(()), 0, AT, TIMES)
    for k, one in enumerate(PATHS):
        rows = k == AT
        assert found[rows] == pytest.approx(
            true_angles(loose(()), between(TIMES[rows], one.t_s, one.encoder_angles)), abs=1e-12
        )


def test_joint_by_joint_is_all_joints_at_once() -> None:
    sets = loose((0, 2))
    found = link_angles(PATHS, sets, 0, AT, TIMES)
    for k, one in enumerate(PATHS):
        rows = k == AT
        whole = simulate(PLANT, sets, drive_joint(PLANT, one.encoder_angles)).link[0]
        assert found[rows] == pytest.approx(between(TIMES[rows], one.t_s, whole), abs=2e-8)


def test_a_course_bends_between_its_rows() -> None:
    t = np.array([1.2345, 2.3456])
    exact = 0.3 * np.sin(2.0 * t[:, None] + np.arange(N))
    found = link_angles(PATHS, neutral_sets(N), 0, np.zeros(2, dtype=np.int64), t)
    assert found == pytest.approx(exact, abs=5e-9)  # lines are 1.5e-5 rad off: 0.06 mm at 4 m


def test_a_course_is_simulated_once_and_only_for_the_joint_that_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[int] = []
    course = kernel.link_side_course
    monkeypatch.setattr(kernel, "link_side_course", lambda *a: (runs.append(1), course(*a))[1])
    fresh = (path(0.0),)
    before = link_angles(fresh, loose((0, 2)), 0, AT[:4], TIMES[:4])
    assert len(runs) == 2
    assert np.array_equal(link_angles(fresh, loose((0, 2)), 0, AT[:4], TIMES[:4]), before)
    changed = loose((0, 2))
    changed.joint_parameters[0, 2, kernel.BACKLASH] = 4e-3
    assert not np.array_equal(link_angles(fresh, changed, 0, AT[:4], TIMES[:4]), before)
    assert len(runs) == 3


def test_the_side_that_a_course_begins_on_matters_until_its_play_is_crossed() -> None:
    sets, t = loose((1,)), np.array([0.0, 0.003, 1.2, 3.0])
    sides = [link_angles((path(0.0),), sets, 0, np.zeros(4, dtype=np.int64), t, side) for side in (-1.0, 0.0, 1.0)]
    apart = sides[2] - sides[0]
    assert abs(apart[0, 1]) > 1e-3
    assert np.abs(apart[2:]).max() == 0.0
    assert np.abs(np.delete(apart, 1, axis=1)).max() == 0.0
    still = Path(path(0.0).t_s, np.full((400, N), 0.2), PLANT.cycle_s)  # on one side for good: that is its place
    both = [link_angles((still,), sets, 0, np.zeros(4, dtype=np.int64), t, side) for side in (-1.0, 1.0)]
    assert np.array_equal(*both)


def test_a_path_without_actuators_lies_beside_one_with() -> None:
    mixed = (path(0.0), path(10.0, None))
    found = link_angles(mixed, loose((1,)), 0, AT, TIMES)
    plain = link_angles(PATHS, loose(()), 0, AT, TIMES)
    assert found[4:] == pytest.approx(plain[4:], abs=1e-15)
    assert found[:4, 1] != pytest.approx(plain[:4, 1], abs=1e-5)
