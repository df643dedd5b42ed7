"""Recordings made by others: a robot at rest before a motion-capture system, and a crane's lift cylinder."""

import csv
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import confirmed
from scipy.io import loadmat

from diagnosis.answer import answer_json
from diagnosis.behind.points import fit_points, static_data
from diagnosis.budget import budget_of
from diagnosis.localise import localise, merged_stages
from diagnosis.log.units import measured_gains
from diagnosis.reading.read import examine_recording, stages_present
from machine.effects.layout import neutral_sets
from recording.content import Attachment, Recording
from recording.rows import PlcState, Row, StaticPoint
from recording.run import RunInfo

DATA = Path(__file__).parents[5] / "shared" / "data" / "gap"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="recordings of others are not here: no ../shared/data/gap")


def tiago() -> Recording:
    """8 joints, 34 poses, 4 markers on the hand at unknown places, the base in an unknown frame."""
    poses = list(csv.DictReader((DATA / "tiago_static" / "mocap_base_hand.csv").read_text().splitlines()))
    joints = [name for name in poses[0] if name.endswith("joint")]
    toml = (
        '[machine]\nname = "tiago"\n[urdf]\nfile = "a.urdf"\nbase_link = "base_link"\ntip_link = "wrist_ft_tool_link"\n'
    )
    toml += "".join(f'[[joint]]\nname = "{name}"\n' for name in joints)
    toml += "[points]\n" + "".join(f"m{k} = {{ joint = 8 }}\n" for k in range(1, 5))
    rows: list[Row] = [
        StaticPoint(i, tuple(float(row[j]) for j in joints), f"m{k}", *(float(row[f"{axis}{k}"]) for axis in "xyz"))
        for i, row in enumerate(poses)
        for k in range(1, 5)
    ]
    urdf = Attachment("a.urdf", "application/xml", (DATA / "tiago_static" / "tiago_hey5.urdf").read_bytes())
    return Recording("folder", RunInfo("tiago"), toml, tuple(rows), attachments=(urdf,))


def test_poses_at_rest_of_an_arm_given_as_urdf() -> None:
    whole = examine_recording(tiago(), Path("tiago"))
    assert stages_present(whole) == ("structure",)
    assert [one.code for one in whole.findings] == ["duplicate_points"]  # columns 3 and 4 of the file are the same
    found = localise(whole)
    assert (
        1e-3 < np.linalg.norm([place.model_gap for place in found.gap_places]) < 8e-3
    )  # millimetres: the chain is right
    assert merged_stages(whole)[-1][0] == ("joint", "structure")


def test_a_wrong_chain_shows_as_centimetres() -> None:
    """With the torso's joint left out of the chain the hand is off by its travel."""
    made = tiago()
    toml = made.machine_toml.replace('base_link = "base_link"', 'base_link = "torso_lift_link"')
    whole = examine_recording(
        Recording("folder", made.run_info, toml, made.rows, attachments=made.attachments), Path("tiago")
    )
    assert whole.nominal_machine is not None
    assert whole.tables is not None
    assert whole.tables.static is not None
    data = static_data(whole.nominal_machine, whole.tables.static)
    assert data is not None
    fit = fit_points(whole.nominal_machine, neutral_sets(8), data)
    assert np.sqrt(np.mean(np.sum(fit.residual_m**2, axis=1))) > 0.02


def test_the_offset_of_a_wrist_joint_is_named_as_its_owners_say() -> None:
    """They calibrate joint offsets, and know of play at the wrist: that play is what no name takes away here."""
    found = answer_json(budget_of(examine_recording(tiago(), Path("tiago"))))
    there = [one for one in found["budget"]["effects"] if one["status"] != "doubtful"]
    assert ("encoder_bias", 6) in {(one["name"], one["joint"]) for one in there}  # arm_5, the wrist's first
    assert 0.4 < found["shrink"]["overall"]["closed_frac"] < 0.9
    assert "repeats" in {one["signal"] for one in found["missing"]}
    assert found["findings"][0]["text"].endswith("drop it, or give its own")


@pytest.mark.parametrize("turned", [True, False])
def test_an_oil_pressure_is_no_joint(turned: bool) -> None:
    """A benchmark of nonlinear identification: no linear model fits, whether it is taken for an angle or a speed."""
    mat = loadmat(DATA / "hydraulic_actuator" / "actuator.mat")
    u, p, step_s = mat["u"].ravel(), mat["p"].ravel() / mat["p"].std(), 0.05
    angle = 0.1 * (p if turned else np.cumsum(p - p.mean()) * step_s)
    command = (u - u.mean()) / np.abs(u - u.mean()).max()
    found = answer_json(
        budget_of(examine_recording(one_joint(step_s * np.arange(len(u)), angle, command, "revolute"), Path("oil")))
    )
    assert found["verdict"] in ("outside", "undecided")
    assert not confirmed(found)


def one_joint(t: np.ndarray, at: np.ndarray, command: np.ndarray, kind: str) -> Recording:
    """Encoder (m,) and valve command (m,) of one joint, and nothing else; its gain is measured."""
    gain = abs(float(measured_gains(t, at[:, None], command[:, None])[0]))
    toml = f'[machine]\nname = "made by others"\n[[joint]]\nname = "lift"\ntype = "{kind}"\ndh_convention = "classic"\n'
    toml += "a_m = 0.0\nd_m = 0.0\nalpha_deg = 0.0\ntheta_offset_deg = 0.0\n"
    toml += f"velocity_gain_rad_s = {gain:.6f}\nvalve_frequency_hz = 40.0\nvalve_damping = 0.7\n"
    toml += "[plc]\ncycle_s = 0.001\n" + f"log_cycle_s = {round(float(np.median(np.diff(t))), 3)}\n"
    missing = float("nan")
    rows: list[Row] = [
        PlcState(float(t[k]), -1, (), (), (float(at[k]),), (float(command[k]),), (), (), missing, missing)
        for k in range(len(t))
    ]
    return Recording("folder", RunInfo("made by others"), toml, tuple(rows))


def test_one_cylinder_with_its_valve_signal_is_enough_for_the_actuator() -> None:
    """PATU 655 lift boom: stroke as a prismatic joint, valve voltage about its middle over its half range."""
    mat = loadmat(DATA / "patu_lift_boom" / "lift_1dof.mat")
    t, u, stroke = mat["t"].ravel()[::10], mat["U1"].ravel()[::10], mat["s1"].ravel()[::10]
    middle = 0.5 * (u.max() + u.min()) if u.min() > 0.0 else 0.0
    command = (u - middle) / max(float(np.abs(u - middle).max()), 1e-9)
    whole = examine_recording(one_joint(t, stroke, command, "prismatic"), Path("patu"))
    assert stages_present(whole) == ("actuator",), [str(one) for one in whole.findings]
    assert {"no_segments", "no_repeats"} <= {one.code for one in whole.findings}
    found = localise(whole)
    assert not found.floor_known
    assert found.gap_places[0].stage == "actuator"
    assert (
        found.gap_places[0].model_gap > 5.0 * found.gap_places[0].noise_floor
    )  # friction, dead zone, oscillation: not a nominal joint


def test_what_a_differential_cylinder_and_its_oil_do_is_told_in_part() -> None:
    """Its two chambers differ, which is an asymmetry; that it swings in its oil (1.4 to 2.5 Hz) has no name here.

    Of what is above a noise that nobody measured, it is more than the asymmetry explains.
    """
    mat = loadmat(DATA / "patu_lift_boom" / "lift_1dof.mat")
    t, u, stroke = (mat[name].ravel()[::10] for name in ("t", "U1", "s1"))
    found = answer_json(
        budget_of(examine_recording(one_joint(t, stroke, u / np.abs(u).max(), "prismatic"), Path("patu")))
    )
    assert found["verdict"] in ("outside", "undecided")
    names = {one["name"] for hypothesis in found["hypotheses"] for one in hypothesis["effects"]}
    assert "valve_asymmetry" in names
    assert "encoder_eccentricity" not in names  # a cylinder does not turn
    assert found["shrink"]["stages"][0]["unit"] == "m/s"
