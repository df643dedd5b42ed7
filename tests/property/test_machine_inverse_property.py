"""Any pose whatever: the inverse gives branches that reproduce it, or a status with a reason; never anything else."""

from importlib.resources import files

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.inverse import InverseStatus, inverse_all, inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import rotation_from_rotvec

CHAIN = chain_of(parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")))
VECTORS = st.tuples(*[st.floats(-3.5, 3.5)] * 3).map(np.array)
POSITIONS = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-2.0, 6.0)).map(np.array)
JOINTS = st.tuples(*[st.floats(0.0, 1.0)] * 6).map(lambda s: CHAIN.q_min + np.array(s) * (CHAIN.q_max - CHAIN.q_min))


@given(VECTORS, POSITIONS, JOINTS)
def test_any_pose_gives_a_solution_or_a_reason(rotvec, position, q_near):
    T = pose(rotation_from_rotvec(rotvec), position)
    for branch in inverse_all(CHAIN, T, q_near):
        assert np.abs(tcp_pose(CHAIN, branch.q_rad) - T).max() < 2e-9
    found = inverse_nearest(CHAIN, T, q_near)
    assert (found.q_rad is None) == (found.status in (InverseStatus.OUT_OF_REACH, InverseStatus.JOINT_LIMIT))
    assert bool(found.reason) == (found.status is not InverseStatus.OK)
    if found.q_rad is not None:
        assert np.all(found.q_rad >= CHAIN.q_min - 1e-9)
        assert np.all(found.q_rad <= CHAIN.q_max + 1e-9)


@given(JOINTS, JOINTS)
def test_any_posture_is_reached_from_any_other(q, q_near):
    """The nearest branch never lies further away than the posture itself, but where a joint may be chosen freely."""
    found = inverse_nearest(CHAIN, tcp_pose(CHAIN, q), q_near)
    assert found.q_rad is not None
    nearest = np.abs(found.q_rad - q_near).max() <= np.abs(q - q_near).max() + 1e-6
    assert nearest or found.status is InverseStatus.SINGULAR
