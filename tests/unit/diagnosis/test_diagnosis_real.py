"""Recordings made by others: a robot at rest before a motion-capture system, and a crane's lift cylinder."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from diagnosis.localise import localise, merged_stages
from diagnosis.points import fit_points, static_data
from diagnosis.reading import examine, stages_present
from diagnosis.units import measured_gains
from machine.effects.layout import neutral_sets
from recording.content import Attachment, Recording
from recording.rows import PlcState, Row, StaticPoint
from recording.run import RunInfo

DATA = Path(__file__).parents[4] / "shared" / "data" / "gap"
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
    whole = examine(tiago(), Path("tiago"))
    assert stages_present(whole) == ("structure",)
    assert [one.code for one in whole.findings] == ["duplicate_points"]  # columns 3 and 4 of the file are the same
    found = localise(whole)
    assert 1e-3 < np.linalg.norm([one.gap for one in found.places]) < 8e-3  # millimetres: the chain is right
    assert merged_stages(whole)[-1][0] == ("joint", "structure")


def test_a_wrong_chain_shows_as_centimetres() -> None:
    """With the torso's joint left out of the chain the hand is off by its travel."""
    made = tiago()
    toml = made.machine_toml.replace('base_link = "base_link"', 'base_link = "torso_lift_link"')
    whole = examine(Recording("folder", made.run, toml, made.rows, attachments=made.attachments), Path("tiago"))
    assert whole.nominal is not None
    assert whole.tables is not None
    assert whole.tables.static is not None
    data = static_data(whole.nominal, whole.tables.static)
    assert data is not None
    fit = fit_points(whole.nominal, neutral_sets(8), data)
    assert np.sqrt(np.mean(np.sum(fit.residual**2, axis=1))) > 0.02


def test_one_cylinder_with_its_valve_signal_is_enough_for_the_actuator() -> None:
    """PATU 655 lift boom: stroke as a prismatic joint, valve voltage about its middle over its half range."""
    mat = loadmat(DATA / "patu_lift_boom" / "lift_1dof.mat")
    t, u, stroke = mat["t"].ravel()[::10], mat["U1"].ravel()[::10], mat["s1"].ravel()[::10]
    middle = 0.5 * (u.max() + u.min()) if u.min() > 0.0 else 0.0
    command = (u - middle) / max(float(np.abs(u - middle).max()), 1e-9)
    gain = abs(float(measured_gains(t, stroke[:, None], command[:, None])[0]))
    toml = '[machine]\nname = "patu"\n[[joint]]\nname = "lift"\ntype = "prismatic"\ndh_convention = "classic"\n'
    toml += "a_m = 0.0\nd_m = 0.0\nalpha_deg = 0.0\ntheta_offset_deg = 0.0\n"
    toml += f"velocity_gain_rad_s = {gain:.6f}\nvalve_frequency_hz = 40.0\nvalve_damping = 0.7\n"
    toml += "[plc]\ncycle_s = 0.001\n" + f"log_cycle_s = {round(float(np.median(np.diff(t))), 3)}\n"
    missing = float("nan")
    rows: list[Row] = [
        PlcState(float(t[k]), -1, (), (), (float(stroke[k]),), (float(command[k]),), (), (), missing, missing)
        for k in range(len(t))
    ]
    whole = examine(Recording("folder", RunInfo("patu"), toml, tuple(rows)), Path("patu"))
    assert stages_present(whole) == ("actuator",), [str(one) for one in whole.findings]
    assert {"no_segments", "no_repeats"} <= {one.code for one in whole.findings}
    found = localise(whole)
    assert not found.floor_known
    assert found.places[0].stage == "actuator"
    assert found.places[0].gap > 5.0 * found.places[0].floor  # friction, dead zone, oscillation: not a nominal joint
