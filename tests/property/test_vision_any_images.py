"""Whatever the images hold, vision answers with a status and never raises."""

from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from machine.description import parse_machine_toml
from machine.poses import pose
from machine.rotations import geodesic_angle, rotation_from_rotvec
from server.vision.aruco_source import ArucoPoseSource, MonoArucoPoseSource
from server.vision.contracts import LookStatus, OdometryStatus, PoseStatus
from server.vision.look import average_look, pose_mean
from server.vision.odometry import StereoOdometry

MACHINE = parse_machine_toml(
    (Path(__file__).parents[2] / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
)
STEREO, MONO, ODOMETRY = ArucoPoseSource(MACHINE), MonoArucoPoseSource(MACHINE), StereoOdometry(MACHINE.camera)
IMAGES = st.one_of(
    hnp.arrays(np.uint8, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=40)),
    st.tuples(st.integers(1, 200), st.integers(1, 300), st.integers(0, 2**32 - 1), st.integers(1, 255)).map(
        lambda t: np.random.default_rng(t[2]).integers(0, t[3], (t[0], t[1])).astype(np.uint8)
    ),
    st.tuples(st.integers(0, 255), st.integers(0, 2**32 - 1)).map(
        lambda t: (
            np.random.default_rng(t[1]).integers(0, t[0] + 1, (72, 128)).repeat(10, 0).repeat(10, 1).astype(np.uint8)
        )
    ),
)


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(left=IMAGES, right=IMAGES, t_ns=st.integers(-(2**62), 2**62))
def test_any_pair_gives_statuses(left, right, t_ns):
    for source in (STEREO, MONO):
        observation = source.observe(left, right, t_ns)
        for found in (observation.tool, observation.ooi):
            assert isinstance(found.status, PoseStatus)
            assert (found.T_cam_object is None) == (found.status in (PoseStatus.NOT_SEEN, PoseStatus.REJECTED))
            assert found.reason or found.status is PoseStatus.OK
    look = average_look([STEREO.observe(left, right, t_ns)])
    assert isinstance(look.status, LookStatus)
    result = ODOMETRY.process(left, right, t_ns)
    assert isinstance(result.status, OdometryStatus)
    assert np.isfinite(result.T_vo_cam).all()
    ODOMETRY.reset()


VECTORS = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))


@settings(max_examples=50, deadline=None)
@given(rotvec=VECTORS, position=VECTORS, seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_pose_mean_moves_with_its_poses(rotvec, position, seed, count):
    """Mean of G T_i is G mean(T_i): no axis, no origin is special, but where a pose is at the limit of being kept."""
    rng = np.random.default_rng(seed)
    Ts = np.array(
        [pose(rotation_from_rotvec(0.05 * rng.normal(size=3)), 0.01 * rng.normal(size=3)) for _ in range(count)]
    )
    covariances = np.tile(np.diag([0.05**2] * 3 + [0.01**2] * 3), (count, 1, 1))
    G = pose(rotation_from_rotvec(rotvec), position)
    of_moved, moved = pose_mean(G @ Ts, covariances), pose_mean(Ts, covariances)
    assume((of_moved.inliers == moved.inliers).all())
    one, other = of_moved.T_mean, G @ moved.T_mean
    assert geodesic_angle(one[:3, :3], other[:3, :3]) < 1e-6
    assert np.abs(one[:3, 3] - other[:3, 3]).max() < 0.02
