"""The foreign plant against figures it was not made from: the file's kinematics, published lengths, virtual work."""

import numpy as np
import pytest

pytest.importorskip("exudyn", reason="the foreign plant is simulated by Exudyn: pip install -e '.[bench]'")

from benchmarks.diagnosis.sealed import foreign_exudyn, foreign_plant, foreign_valves
from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_machine as m
from benchmarks.diagnosis.sealed import foreign_numbers as k
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.arm_effects import ARM_EFFECTS
from benchmarks.diagnosis.sealed.faults import Injected, faults_of
from benchmarks.diagnosis.sealed.foreign_arm import arm_of
from benchmarks.diagnosis.sealed.own_plant import Course
from benchmarks.diagnosis.sealed.plants import OWN, plant_named
from diagnosis.log.nominal import nominal_of
from machine.effects.entries import make_entry, pack_effects
from machine.effects.registry import effect_named
from machine.effects.structure import link_poses, reference_torques, tcp_poses

NOMINAL = nominal_of(m.toml())
Q = np.array([0.3, 0.6, -1.5])


def tree_at(q: np.ndarray) -> np.ndarray:
    out = np.zeros(7)
    out[list(g.DRIVEN)] = q
    return out


def driven(command: tuple[float, float, float], seconds: float, *injected: Injected) -> Course:
    """From home with constant valve commands, no disturbance."""
    rows = round(seconds / own.CYCLE_S)
    ref, given = np.tile(k.HOME_RAD, (rows, 1)), np.tile(np.array(command), (rows, 1))
    return foreign_plant.run(faults_of(injected, 3), ref, np.zeros((rows, 3)), given)


@pytest.fixture(scope="module")
def at_rest() -> Course:
    return driven((0.0, 0.0, 0.0), 1.5)


@pytest.fixture(scope="module")
def moving() -> Course:
    return driven((0.2, 0.25, -0.2), 1.2)


@pytest.mark.parametrize(("one", "parameters"), [(None, {}), *ARM_EFFECTS])
def test_the_arm_is_the_files_and_bends_as_the_catalogue_defines(one: Injected | None, parameters: dict) -> None:
    arm, entries = arm_of(faults_of((one,) if one else (), 3)), []
    if one:
        effect = effect_named(one.name)
        assert effect is not None
        entries.append(make_entry(effect, one.joint, parameters))
    assert NOMINAL.arm is not None
    sets = pack_effects(entries, 3)
    theirs = link_poses(NOMINAL.arm, sets, Q[None])[0]
    for name, point in arm.points(tree_at(Q)).items():
        link, xyz = m.POINTS[name]
        np.testing.assert_allclose(point, theirs[link][:3, :3] @ np.array(xyz) + theirs[link][:3, 3], atol=1e-12)
    np.testing.assert_allclose(arm.tcp(tree_at(Q)), tcp_poses(NOMINAL.arm, sets, Q[None])[0], atol=1e-12)


def test_the_simulated_bodies_hang_on_the_files_kinematics() -> None:
    R, p = g.tree_frames(tree_at(Q))
    tcp = arm_of(faults_of((), 3)).tcp(tree_at(Q))
    np.testing.assert_allclose(R[5] @ g.tool_place() + p[5], tcp[:3, 3], atol=1e-12)
    weight = sum(one.mass for one in g.tree_bodies())
    assert weight == pytest.approx(k.PILLAR_KG + k.LIFT_KG + k.TILT_KG + k.BRACKET_KG + k.ROD_KG + k.TOOL_KG)
    assert weight == pytest.approx(sum(mass for mass, _ in m.bodies()))


def test_published_cylinders_fit_the_published_points() -> None:
    # The straight tilt boom leaves its cylinder pulled in: closed lengths and points were published apart.
    assert g.tilt_length(0.0) == pytest.approx(k.TILT_CYLINDER[0], abs=5e-3)
    for joint, (length, (closed, stroke)) in enumerate(
        ((g.lift_length, k.LIFT_CYLINDER), (g.tilt_length, k.TILT_CYLINDER)), start=1
    ):
        for angle in np.deg2rad(k.RANGES_DEG[joint]):
            assert closed <= length(angle) <= closed + stroke
    lug = np.array([g.A2, 0.0]) + g.flat(-1.2) @ np.array(k.TILT_LUG)
    assert np.linalg.norm(g.bracket_tip(-1.2) - lug) == pytest.approx(k.ROD_M, abs=1e-12)


def test_levers_are_what_the_integrated_cylinders_move() -> None:
    q2, q3 = np.deg2rad([20.0, -80.0])
    assert g.lever(1, q2) == pytest.approx((g.lift_length(q2 + 1e-4) - g.lift_length(q2 - 1e-4)) / 2e-4, rel=1e-3)
    assert g.lever(2, q3) == pytest.approx((g.tilt_length(q3 + 1e-4) - g.tilt_length(q3 - 1e-4)) / 2e-4, rel=1e-3)


def test_the_load_is_the_catalogues() -> None:
    assert NOMINAL.arm is not None
    low, high = np.deg2rad(np.array(k.RANGES_DEG)).T
    largest = reference_torques(NOMINAL.arm, pack_effects([], 3), low, high)
    rows = foreign_valves.load_rows()
    arm = arm_of(faults_of((), 3))
    torques, _ = arm.weights(*arm.chain(Q, np.eye(3)))
    terms = np.array([np.cos(Q[1]), np.sin(Q[1]), np.cos(Q[1] + Q[2]), np.sin(Q[1] + Q[2])])
    np.testing.assert_allclose(rows @ terms, torques[1:] / largest[1:], rtol=5e-3)  # a grid each


def test_closed_valves_carry_the_weights_by_virtual_work(at_rest: Course) -> None:
    bodies = g.tree_bodies()
    forces = g.cylinder_forces(bodies, g.at_rest(bodies, k.HOME_RAD))
    p = at_rest.pressures[-1]
    found = p[[0, 2, 4]] * k.AREA_A - p[[1, 3, 5]] * np.array([k.AREA_A, k.AREA_B, k.AREA_B])
    np.testing.assert_allclose(found[1:], forces[1:], rtol=5e-3)  # 30 kN and -7 kN
    assert abs(found[0]) < 50.0
    assert np.abs(at_rest.smooth - k.HOME_RAD).max() < 1e-4
    np.testing.assert_allclose(at_rest.tree_q[-1, 6], g.bracket_angle(float(at_rest.tree_q[-1, 4])), atol=1e-6)


def test_springs_sag_by_the_torque_of_the_weights(at_rest: Course) -> None:
    arm = arm_of(faults_of((), 3))
    torques, _ = arm.weights(*arm.chain(k.HOME_RAD, np.eye(3)))
    np.testing.assert_allclose(at_rest.tree_q[-1, [3, 5]], torques[1:] / np.array(k.SPRINGS[1:]), rtol=0.02)


def test_the_valves_move_the_joints_as_the_nominal_machine_says(moving: Course) -> None:
    half = len(moving.smooth) // 2
    speed = (moving.smooth[-1] - moving.smooth[half]) / ((len(moving.smooth) - 1 - half) * own.CYCLE_S)
    band = k.DEAD_BAND
    opened = [np.sign(u) * (abs(u) - k.HYSTERESIS - band) / (1.0 - band) for u in (0.2, 0.25, -0.2)]
    np.testing.assert_allclose(speed, np.array(k.SPEED_FULL) * opened, rtol=0.08)
    for row in moving.tree_q[::40]:
        assert row[6] == pytest.approx(g.bracket_angle(float(row[4])), abs=1e-5)  # Exudyn keeps the loop closed


def test_an_effect_of_the_valve_is_as_large_as_it_says(moving: Course) -> None:
    faster = driven((0.2, 0.25, -0.2), 1.2, Injected("flow_gain_error", 2, {"gain_frac": 0.1}))
    half = len(moving.smooth) // 2
    way = [course.smooth[-1] - course.smooth[half] for course in (faster, moving)]
    assert way[0][1] / way[1][1] == pytest.approx(1.1, abs=0.01)
    np.testing.assert_allclose(way[0][[0, 2]], way[1][[0, 2]], rtol=0.01)


def test_the_same_run_gives_the_same_numbers() -> None:
    first, again = (driven((0.2, 0.25, -0.2), 0.3) for _ in range(2))
    np.testing.assert_array_equal(first.smooth, again.smooth)


def test_a_step_is_as_fine_as_the_tolerance_says(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = driven((0.2, 0.25, -0.2), 0.6)
    monkeypatch.setattr(foreign_exudyn, "TOLERANCE", 1e-7)
    np.testing.assert_allclose(plain.smooth, driven((0.2, 0.25, -0.2), 0.6).smooth, atol=2e-5)  # of some 60 mrad


def test_both_plants_answer_the_same_questions() -> None:
    for name, columns in (("own", 11), ("foreign", 7)):
        plant = plant_named(name)
        readings, trees = plant.rest_poses(faults_of((), 3), np.random.default_rng(1), 3)
        assert (readings.shape, trees.shape) == ((4, 3), (4, columns))
        motors = list(plant.motors)
        np.testing.assert_allclose(trees[:, motors], readings, atol=2e-3)
        assert len(set(motors) | set(plant.springs)) == len(motors) + len(plant.springs)
        assert set(plant.arm(faults_of((), 3)).points(trees[0])) == {"elbow", "tip", "side"}
    assert OWN.toml() == own.toml()
    with pytest.raises(KeyError, match="no plant"):
        plant_named("third")
