"""Behind the encoders, as others log it: a tracker whose clock is off, odometry alone, an unstated weight."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import MACHINE, MACHINE_TOML, likely
from static_points import ARM, POINTS, TRACKER, static_recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import examine_recording
from machine.effects.entries import make_entry, pack_effects
from machine.effects.layout import ParameterSets, neutral_sets
from machine.effects.registry import effect_named
from machine.effects.structure import link_poses, tcp_poses
from recording.content import Recording
from recording.rows import OdometryRow, PlcState, Row, TrackerPoint
from recording.run import RunInfo, Segment

Q0 = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
SECONDS, NAN = 60.0, float("nan")


def course(t: np.ndarray) -> np.ndarray:
    """Joint angles (m, 6) [rad] at times (m,)."""
    return Q0 + 0.15 * np.sin(t[:, None] * np.array([0.5, 0.7, 0.9, 1.1, 1.3, 0.6]) + np.arange(6))


def logged() -> list[Row]:
    t = 0.01 * np.arange(round(SECONDS / 0.01))
    rows = [(float(at), tuple(q.tolist())) for at, q in zip(t, course(t), strict=True)]
    return [PlcState(at, k, (), (), q, (), (), (), NAN, NAN) for k, (at, q) in enumerate(rows)]


def found_in(rows: list[Row], toml: str = MACHINE_TOML) -> list[tuple[str, int | None, dict[str, float]]]:
    segments = tuple(Segment(f"s{k}", "workcycle", 15.0 * k, 15.0 * k + 14.9) for k in range(4))
    made = Recording("folder", RunInfo("behind", "", None, 0.0, 0.0, None, segments), toml, (*logged(), *rows))
    answer = answer_json(budget_of(examine_recording(made, Path("behind"))))
    assert answer["verdict"] == "effects", answer["why"]
    first = likely(answer)
    return [(one["name"], one["joint"], {k: v["value"] for k, v in one["parameters"].items()}) for one in first]


def test_a_trackers_clock_may_be_off() -> None:
    rng, stamps, late_s = np.random.default_rng(5), 0.3 * np.arange(1, 198), 0.02
    rows: list[Row] = []
    for stamp, links in zip(stamps, link_poses(ARM, neutral_sets(6), course(stamps - late_s)), strict=True):
        at = (TRACKER @ links[6] @ np.array([0.0, -0.3, 0.1, 1.0]))[:3] + rng.normal(0.0, 3e-4, 3)
        rows.append(TrackerPoint(float(stamp), "tip", *map(float, at)))
    ((name, joint, numbers),) = found_in(rows, MACHINE_TOML + POINTS)
    assert (name, joint) == ("clock_offset", None)
    assert numbers["offset_s"] == pytest.approx(late_s, abs=1e-3)


def test_odometry_alone_tells_its_scale() -> None:
    rng, stamps, scale = np.random.default_rng(6), 0.1 * np.arange(1, 590), 1.03
    Ts = tcp_poses(ARM, neutral_sets(6), course(stamps)) @ MACHINE.T_tcp_cam_left
    places = scale * (np.linalg.inv(Ts[0]) @ Ts)[:, :3, 3] + rng.normal(0.0, 5e-4, (len(stamps), 3))
    rows: list[Row] = [
        OdometryRow(float(t), *map(float, at), 1.0, 0.0, 0.0, 0.0) for t, at in zip(stamps, places, strict=True)
    ]
    ((name, joint, numbers),) = found_in(rows)
    assert (name, joint) == ("odometry_scale", None)
    assert numbers["scale_frac"] == pytest.approx(scale - 1.0, abs=1e-3)


def loaded(compliance: float, mass_kg: float) -> ParameterSets:
    wanted = (
        ("gravity_sag", 2, {"compliance_rad_nm": compliance}),
        ("payload_error", None, {"mass_kg": mass_kg}),
    )
    effects = [(effect_named(name), joint, parameters) for name, joint, parameters in wanted]
    return pack_effects(
        [make_entry(one, joint, parameters) for one, joint, parameters in effects if one is not None], 6
    )


def test_a_weight_is_found_beside_what_yields_to_it() -> None:
    answer = answer_json(budget_of(examine_recording(static_recording(loaded(2e-6, 80.0)), Path("loaded"))))
    assert answer["verdict"] == "effects", answer["why"]
    first = {one["name"]: one["parameters"] for one in likely(answer)}
    assert set(first) == {"gravity_sag", "payload_error"}
    assert first["payload_error"]["mass_kg"]["value"] == pytest.approx(80.0, abs=8.0)
