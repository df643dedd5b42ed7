"""Valves and quiet encoders, logged ten times as slowly as the machine runs, commands that jump at any time."""

from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import likely
from scipy.linalg import expm

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis

SPEED, OMEGA, DAMPING = 0.5, 2.0 * np.pi * 8.0, 0.8
CYCLE_S, EVERY, SECONDS, NOISE_RAD = 1e-3, 10, 20.0, 1e-5
KINDS = ("multisine", "multisine", "multisine", "multisine", "workcycle", "steps", "sweep")
JOINT = (
    '[[joint]]\nname = "j{0}"\ntype = "revolute"\ndh_convention = "classic"\na_m = 1.0\nd_m = 0.0\nalpha_deg = 0.0\n'
    "theta_offset_deg = 0.0\nq_min_deg = -360.0\nq_max_deg = 360.0\nqd_max_deg_s = 60.0\nqdd_max_deg_s2 = 200.0\n"
    f"velocity_gain_rad_s = {SPEED}\nvalve_frequency_hz = 8.0\nvalve_damping = {DAMPING}\n"
)
MACHINE = "\n".join(
    ['[machine]\nname = "valves"', f"[plc]\ncycle_s = {CYCLE_S}\nlog_cycle_s = {EVERY * CYCLE_S}"]
    + [JOINT.format(number) for number in (1, 2)]
)


def command(kind: str) -> np.ndarray:
    """(cycles, 2); the same each time a kind is run."""
    rng, t = np.random.default_rng(KINDS.index(kind)), np.arange(0.0, SECONDS, CYCLE_S)
    columns = []
    for _ in range(2):
        if kind == "multisine":
            heights = rng.uniform(0.05, 0.2, 3)
            columns.append(
                heights @ np.sin(2.0 * np.pi * np.outer([0.1, 0.31, 0.9], t) + rng.uniform(0.0, 6.0, (3, 1)))
            )
        elif kind == "sweep":
            columns.append(0.4 * np.sin(2 * np.pi * (0.05 + 0.04 * t) * t))
        elif kind == "steps":
            columns.append(rng.uniform(-0.6, 0.6, 11)[(t // 2.0).astype(int)] * np.where(t % 4.0 < 2.0, 1.0, -1.0))
        else:
            starts = rng.uniform(0.0, SECONDS - 4.0, 4)
            columns.append(np.sum([0.3 * ((t > one) & (t < one + 2.0)) for one in starts], axis=0) - 0.2)
    return np.stack(columns, axis=1)


def made(place: Path, gain: float) -> Path:
    """Each cycle's motion in closed form: a machine has no step."""
    model = np.array([[0.0, SPEED, 0, 0], [0, 0, 1, 0], [0, -(OMEGA**2), -2 * DAMPING * OMEGA, OMEGA**2], [0, 0, 0, 0]])
    onward, rng = expm(model * CYCLE_S), np.random.default_rng(7)
    faster = np.array([1.0 + gain, 1.0])
    state, rows, segments = np.zeros((4, 2)), [], []
    for number, kind in enumerate(KINDS):
        start = number * SECONDS
        for k, u in enumerate(command(kind)):
            if k % EVERY == 0:
                seen = state[0] + rng.normal(0.0, NOISE_RAD, 2)
                rows.append([start + k * CYCLE_S, len(rows), *seen, *u])
            state[3] = u
            after = onward @ state
            after[0] = state[0] + faster * (after[0] - state[0])
            state = after
        ends = f"t_start_plc_s = {start}\nt_end_plc_s = {start + SECONDS - EVERY * CYCLE_S}"
        segments.append(f'[[segment]]\nname = "s{number}"\nkind = "{kind}"\n{ends}\nrepeat_of = "{kind}"')
    header = "t_plc_s,seq_received,q_1_rad,q_2_rad,u_1_frac,u_2_frac"
    log = "\n".join([header, *(",".join(repr(float(value)) for value in row) for row in rows)])
    (place / "plc.csv").write_text(log + "\n", encoding="utf-8")
    (place / "machine.toml").write_text(MACHINE, encoding="utf-8")
    run = '[run]\nname = "valves"\nformat_version = 1'
    (place / "run.toml").write_text("\n".join([run, *segments]), encoding="utf-8")
    return place


@pytest.mark.parametrize(("gain", "verdict"), [(0.0, "none"), (0.03, "effects")])
def test_what_a_coarse_log_cannot_tell_is_no_gap(tmp_path: Path, gain: float, verdict: str) -> None:
    found = answer_json(budget_of(read_for_diagnosis(made(tmp_path, gain))))
    assert found["verdict"] == verdict, found["why"]
    told = [(one["name"], one["joint"]) for one in likely(found)]
    assert told == ([("flow_gain_error", 1)] if gain else [])
