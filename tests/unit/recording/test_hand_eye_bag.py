"""`longreach hand-eye --bag`: the hand by joint states and the URDF, the target by its pose topic."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

pytest.importorskip("rosbags")

from foreign_logs import BagMaker

from longreach.cli import app
from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.layout import neutral_sets
from machine.effects.structure import tcp_poses

WRIST = """<robot name="w"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""


def test_a_bag_gives_the_mount(tmp_path: Path) -> None:
    X, Y = np.eye(4), np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_rotvec([0.1, -0.3, 0.8]).as_matrix(), [0.05, 0.02, 0.1]
    Y[:3, 3] = 1.2, 0.1, 0.2
    arm, names = arm_from_urdf(WRIST, "base", "c")
    with BagMaker(tmp_path / "bag", "MCAP") as bag:
        for k in range(600):
            t = 0.02 * k
            q = np.array([0.6 * np.sin(0.9 * t), 0.5 * np.sin(1.3 * t + 1.0), 0.7 * np.sin(0.7 * t)])
            bag.joint_state("/joint_states", t, list(names), q)
            if k % 3 == 0:
                T = np.linalg.inv(tcp_poses(arm, neutral_sets(3), q[None])[0] @ X) @ Y
                bag.pose("/board", t, T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat())
    (tmp_path / "w.urdf").write_text(WRIST, encoding="utf-8")
    call = ["hand-eye", "--bag", str(tmp_path / "bag"), "--pose-topic", "/board", "--urdf", str(tmp_path / "w.urdf")]
    done = CliRunner().invoke(app, [*call, "--json", str(tmp_path / "a.json")])
    assert done.exit_code == 0, done.output
    found = np.array(json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["T_parent_cam"])
    assert np.abs(found - X).max() < 1e-3
    done = CliRunner().invoke(app, [*call[:4], "/none", *call[5:]])
    assert done.exit_code != 0
