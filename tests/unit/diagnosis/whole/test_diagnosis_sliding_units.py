"""What is said of a joint that slides is in m: totals, plots, sizes, proposals; and never in one mean with rad."""

from pathlib import Path

import numpy as np
import pytest
from one_joint_cases import Machine, recorded

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from diagnosis.experiments.described import describe_motions, experiment_of
from diagnosis.experiments.library import Motion, Postures
from diagnosis.localise import Place, totals_of
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.report.chain import is_total, stage_shares
from diagnosis.report.curves import curves_of
from diagnosis.sliding import column_of, in_metres, unit_of


def place(joint: int | None, unit: str, gap: float, share: float, axis: str | None = None) -> Place:
    return Place("structure" if axis else "actuator", joint, axis, "all", gap, 0.1 * gap, unit, 1e3 * gap, share)


def test_a_total_is_of_one_unit() -> None:
    mixed = (place(1, "rad/s", 0.3, 0.2), place(2, "m/s", 0.01, 0.5), place(3, "rad/s", 0.4, 0.3))
    turned, slid = totals_of(mixed)
    assert (turned.unit, slid.unit) == ("rad/s", "m/s")
    assert turned.model_gap == pytest.approx(np.hypot(0.3, 0.4) / np.sqrt(2.0))
    assert slid.model_gap == pytest.approx(0.01)
    assert (turned.joint, slid.joint) == (None, None)
    assert turned.share_frac + slid.share_frac == pytest.approx(1.0)
    rows = [{"stage": one.stage, "joint": None, "axis": None, "share_frac": one.share_frac} for one in (slid, turned)]
    assert all(map(is_total, rows))
    assert stage_shares({"localisation": rows}) == pytest.approx({"actuator": 1.0})


def test_axes_in_rad_count_beside_those_in_metres() -> None:
    (one,) = totals_of((place(None, "m", 0.3, 0.6, "x"), place(None, "rad", 9.0, 0.4, "roll")))
    assert (one.unit, one.model_gap, one.share_frac) == ("m", pytest.approx(0.3), pytest.approx(1.0))


def test_units_and_columns_go_by_the_joint() -> None:
    sliding = (False, True)
    assert [unit_of("rad/(N m)", sliding, j) for j in range(3)] == ["rad/(N m)", "m/N", "rad/(N m)"]
    assert [column_of("q_ref_{j}_rad", sliding, j) for j in range(2)] == ["q_ref_1_rad", "q_ref_2_m"]
    sag = {"name": "gravity_sag", "joint": 2, "parameters": {"compliance_rad_nm": {"value": 1.0, "unit": "rad/(N m)"}}}
    assert in_metres(sag, sliding)["parameters"]["compliance_rad_nm"]["unit"] == "m/N"


@pytest.mark.parametrize(
    "experiment",
    [Motion("steps", "steps", np.linspace(0.0, 1.0, 41)[:, None] * [1.0, 0.5]), Postures("looks", np.ones((3, 2)))],
)
def test_a_proposal_says_what_its_numbers_are(experiment: Motion | Postures) -> None:
    assert describe_motions(experiment, (False, True))["joint_units"] == ["rad", "m"]
    assert "joint_units" not in describe_motions(experiment, (False, False))
    assert np.allclose(experiment_of(describe_motions(experiment, (False, True))).q[-1], experiment.q[-1])


def test_a_cylinder_is_told_in_metres_throughout(tmp_path: Path) -> None:
    found = budget_of(
        read_for_diagnosis(
            recorded(tmp_path, Machine(prismatic=True, kinds=("multisine", "steps"), gain=lambda _t: 1.1))
        )
    )
    told = answer_json(found)
    places = {(one["stage"], one["unit"]) for one in told["localisation"]}
    assert ("actuator", "m/s") in places
    assert not [unit for _, unit in places if "rad" in unit]
    assert not [one["unit"] for one in told["shrink"]["stages"] if "rad" in one["unit"]]
    sliding = found.recording.nominal_machine.joint_slides
    plots = {
        (one.replayed_trajectory.signal_label, one.replayed_trajectory.unit)
        for one in curves_of(found.held_out, sliding)
        if one.replayed_trajectory is not None
    }
    assert ("joint position", "m") in plots
    assert "joint angle" not in {signal for signal, _ in plots}
