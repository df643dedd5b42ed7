"""A machine with many small faults and no baseline: four offsets of an arm, five faults of a valve; poses that err as
one; joints that slide.
"""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import entry, recording

from benchmarks.diagnosis.experiments.arm import Link, frames, machine_toml
from diagnosis.answer import answer
from diagnosis.behind.points import static_data
from diagnosis.behind.saturated import saturated_noise
from diagnosis.diagnose import diagnose
from diagnosis.reading.read import examine
from diagnosis.search.candidates import named
from diagnosis.sliding import in_metres
from machine.effects.layout import ParameterSets, neutral_sets
from recording.content import Recording
from recording.rows import Row, StaticPoint
from recording.run import RunInfo

LINKS = (
    Link("slew", 0.0, 0.8, 90.0, 0.0, -120.0, 120.0, 300.0, (0.0, 0.0, 0.0)),
    Link("boom", 2.5, 0.0, 0.0, 0.0, -30.0, 80.0, 200.0, (-1.2, 0.0, 0.0)),
    Link("tilt", 1.2, 0.0, 90.0, 20.0, -90.0, 60.0, 50.0, (0.0, 0.0, 0.0)),
    Link("yaw", 0.2, 0.3, -90.0, 0.0, -60.0, 60.0, 10.0, (0.0, 0.0, 0.0)),
    Link("roll", 0.1, 0.3, 0.0, 0.0, -150.0, 150.0, 8.0, (0.0, 0.0, 0.0)),
)
BIAS_RAD = np.array([0.0, 0.008, -0.012, 0.02, -0.03])
POINTS = {"a": (0.0, 0.2, 0.1), "b": (0.2, 0.0, -0.1)}
NOISE_M = 3e-4


def poses_at_rest(bias: np.ndarray, visits: int = 2, shift_m: float = 0.0, seed: int = 1) -> Recording:
    """40 poses, each seen so many times, two points on the last link; the hand beside its model at each visit."""
    rng = np.random.default_rng(seed)
    given = "\n".join(f"{name} = {{ joint = 5, xyz_m = {list(at)} }}" for name, at in POINTS.items())
    toml = machine_toml(LINKS, driven=False).replace("tip = { joint = 5, xyz_m = [0.0, 0.0, 0.0] }", given)
    low, high = (np.deg2rad([0.8 * getattr(link, name) for link in LINKS]) for name in ("low_deg", "high_deg"))
    rows: list[Row] = []
    for number in range(40 * visits):
        if number % visits == 0:
            q = rng.uniform(low, high)
        T, beside = frames(LINKS, q - bias)[-1], rng.normal(0.0, shift_m, 3)
        for name, at in POINTS.items():
            x, y, z = (T @ [*at, 1.0])[:3] + beside + rng.normal(0.0, NOISE_M, 3)
            rows.append(StaticPoint(number, tuple(q.tolist()), name, float(x), float(y), float(z)))
    return Recording("folder", RunInfo("made up"), toml, tuple(rows))


def told(made: Recording) -> dict[str, dict[str, float]]:
    """Sizes of the first hypothesis, by "name joint"; the verdict has to be that effects explain the gap."""
    found = answer(diagnose(examine(made, Path("made up"))))
    assert found["verdict"] == "effects"
    return {
        f"{one['name']} {one['joint']}": {name: number["value"] for name, number in one["parameters"].items()}
        for one in found["hypotheses"][0]["effects"]
    }


@pytest.mark.parametrize("visits", [2, 1])
def test_four_offsets_are_found_with_and_without_a_known_floor(visits: int) -> None:
    found = told(poses_at_rest(BIAS_RAD, visits))
    assert set(found) == {f"encoder_bias {j}" for j in (2, 3, 4, 5)}
    sizes = [found[f"encoder_bias {j}"]["bias_rad"] for j in (2, 3, 4, 5)]
    np.testing.assert_allclose(sizes, BIAS_RAD[1:], atol=3e-4)


def test_five_faults_of_one_valve_are_found() -> None:
    """Three names alone are taken for others: a wave and a droop do what an asymmetry and a gain do."""
    faults = {
        "valve_deadband": ("half_width_frac", 0.02),
        "valve_lag": ("time_constant_s", 0.05),
        "valve_asymmetry": ("gain_frac", 0.1),
        "flow_gain_error": ("gain_frac", -0.12),
        "valve_hysteresis": ("half_width_frac", 0.01),
    }
    entries = tuple(entry(name, 2, **{parameter: size}) for name, (parameter, size) in faults.items())
    kinds = ("repeat", "repeat", "repeat", "repeat", "steps", "steps", "sweep")
    found = told(recording(kinds, entries, seed=3))
    assert set(found) == {f"{name} 2" for name in faults}
    for name, (parameter, size) in faults.items():
        assert found[f"{name} 2"][parameter] == pytest.approx(size, rel=0.02)


@pytest.mark.parametrize("visits", [1, 2])
def test_poses_that_err_as_one_speak_once_each(visits: int) -> None:
    """A hand 1.5 mm beside its model takes both points along: that is no name, and no reason for one."""
    made = poses_at_rest(np.zeros(5), visits, shift_m=1.5e-3 / np.sqrt(3.0))
    found = answer(diagnose(examine(made, Path("made up"))))
    assert found["verdict"] == "none", found["why"]


def test_what_points_of_an_instant_share_is_told_from_their_own_noise() -> None:
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(500), 3)
    rows = rng.normal(0.0, 1e-4, 1500) + rng.normal(0.0, 3e-4, 500)[groups]

    def residual(sets: ParameterSets) -> np.ndarray:
        return np.tile(rows, (sets.sets, 1)) - sets.joint[:, 0, :1] * np.linspace(-1.0, 1.0, 1500)

    own, shared = saturated_noise(residual, neutral_sets(1), named(("encoder_bias",), (1,)), groups)
    assert own == pytest.approx(1e-4, rel=0.1)
    assert shared == pytest.approx(3e-4, rel=0.1)


def test_a_point_written_twice_counts_once() -> None:
    made = poses_at_rest(np.zeros(5))
    twice = tuple(
        StaticPoint(one.pose_index, one.q_rad, "b", one.x_m, one.y_m, one.z_m)
        for one in made.of(StaticPoint)
        if one.point == "a"
    )
    both = tuple(one for one in made.of(StaticPoint) if one.point == "a") + twice
    whole = examine(Recording("folder", made.run, made.machine_toml, both), Path("made up"))
    assert "duplicate_points" in {one.code for one in whole.findings}
    assert whole.nominal is not None
    assert whole.tables is not None
    assert whole.tables.static is not None
    data = static_data(whole.nominal, whole.tables.static)
    assert data is not None
    assert len(data.xyz) == len(twice)


def test_what_slides_is_told_in_metres() -> None:
    effect = {"name": "encoder_bias", "joint": 2, "parameters": {"bias_rad": {"value": 0.1, "unit": "rad"}}}
    other = {**effect, "joint": 1}
    metres, radians = in_metres([effect, other], (False, True))
    assert metres["parameters"]["bias_rad"]["unit"] == "m"
    assert radians == other
