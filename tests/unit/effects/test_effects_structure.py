"""Where the links are: against kinematics and torques found another way, and each effect's own geometry."""

from dataclasses import replace

import numpy as np
import pytest
from effects_cases import hiab

from machine import kinematics
from machine.chain import chain_of
from machine.effects.arm import DhRow, arm_from_dh, arm_of
from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.encoders import angles_at_rest, true_angles
from machine.effects.entries import make_entry, pack_effects
from machine.effects.kernel import BIAS, ECC_AMPLITUDE, ECC_ORDER, ECC_PHASE, SCALE
from machine.effects.layout import ParameterSets, neutral_sets, slots_of
from machine.effects.registry import effect_named, effects_of
from machine.effects.structure import gravity_torques, link_poses, loads_along, reference_torques, tcp_poses
from machine.errors import MachineError
from machine.rotations import rotation_about, rotvec_from_rotation
from machine.urdf import urdf_text

RNG = np.random.default_rng(4)
QS = RNG.uniform(-1.0, 1.0, (20, 6))
ARM = arm_of(hiab())
NONE = neutral_sets(6)


def packed(name: str, joint: int | None, n: int = 6, **parameters: object) -> ParameterSets:
    effect = effect_named(name)
    assert effect is not None
    return pack_effects([make_entry(effect, joint, parameters)], n)


def test_without_effects_it_is_the_nominal_kinematics() -> None:
    chain = chain_of(hiab())
    assert tcp_poses(ARM, NONE, QS) == pytest.approx(kinematics.tcp_poses(chain, QS), abs=1e-12)


def test_modified_dh_and_urdf_give_the_same_arm() -> None:
    """Classic rows shifted by one are modified rows with a fixed start and end."""
    machine = hiab()
    urdf, names = arm_from_urdf(urdf_text(machine), "base", "tcp")
    assert names == tuple(joint.name for joint in machine.joints)
    assert tcp_poses(urdf, NONE, QS) == pytest.approx(tcp_poses(ARM, NONE, QS), abs=1e-9)
    rows = [DhRow(j.a_m, j.d_m, j.alpha_rad, j.theta_offset_rad) for j in machine.joints]
    shifted = [
        DhRow(
            0.0 if i == 0 else rows[i - 1].a_m,
            row.d_m,
            0.0 if i == 0 else rows[i - 1].alpha_rad,
            row.theta_offset_rad,
            convention="modified",
        )
        for i, row in enumerate(rows)
    ]
    last = np.eye(4)
    last[:3, :3], last[0, 3] = rotation_about("x", rows[-1].alpha_rad), rows[-1].a_m
    modified = arm_from_dh(shifted, last @ machine.T_flange_tcp)
    assert tcp_poses(modified, NONE, QS) == pytest.approx(tcp_poses(ARM, NONE, QS), abs=1e-12)


def test_prismatic_joints_slide_along_z() -> None:
    arm = arm_from_dh([DhRow(0.2, 0.1, 0.3, 0.5, prismatic=True), DhRow(0.4, 0.0, 0.0, 0.0)])
    two = tcp_poses(arm, neutral_sets(2), np.array([[0.0, 0.2], [0.7, 0.2]]))
    assert two[1, :3, 3] - two[0, :3, 3] == pytest.approx([0.0, 0.0, 0.7])
    assert two[1, :3, :3] == pytest.approx(two[0, :3, :3])


def test_torques_are_the_slope_of_the_potential_energy() -> None:
    def energy(q: np.ndarray) -> float:
        links = link_poses(ARM, NONE, q[None])[0]
        centres = np.einsum("kij,kj->ki", links[1:, :3, :3], ARM.com) + links[1:, :3, 3]
        return -float(np.sum(ARM.mass[:, None] * centres * ARM.gravity))

    for q in QS[:5]:
        slope = [(energy(q + h) - energy(q - h)) / 2e-5 for h in 1e-5 * np.eye(6)]
        assert gravity_torques(ARM, NONE, q[None])[0] == pytest.approx(-np.array(slope), abs=1e-3)


def test_loads_are_shares_of_the_reference_torque_and_linear_in_the_payload() -> None:
    machine = hiab()
    limits = np.array([[j.q_min_rad, j.q_max_rad] for j in machine.joints]).T
    reference = reference_torques(ARM, NONE, *limits)
    assert np.isinf(reference[0])  # slew is upright
    assert 5e3 < reference[1] < 3e4
    load, load_kg = loads_along(ARM, NONE, QS, reference)
    assert np.abs(load).max() <= 1.05
    heavy = gravity_torques(ARM, packed("payload_error", None, mass_kg=80.0), QS) / reference
    assert load + 80.0 * load_kg == pytest.approx(heavy, abs=1e-12)


def test_a_small_arm_carries_load_as_well_and_an_upright_joint_none() -> None:
    small = replace(ARM, mass=1e-4 * ARM.mass)
    machine = hiab()
    limits = np.array([[j.q_min_rad, j.q_max_rad] for j in machine.joints]).T
    reference = reference_torques(small, NONE, *limits)
    assert np.isinf(reference[0])
    assert 0.5 < reference[1] < 3.0
    assert np.isinf(reference_torques(replace(ARM, mass=0.0 * ARM.mass), NONE, *limits)).all()


def test_sag_hangs_the_tip_lower_by_the_torque_times_the_compliance() -> None:
    q = np.array([[0.3, 0.2, -0.5, 0.0, 0.5, 0.0]])
    sagged = tcp_poses(ARM, packed("gravity_sag", 2, compliance_rad_nm=1e-6), q)
    turned = q.copy()
    turned[0, 1] += 1e-6 * gravity_torques(ARM, NONE, q)[0, 1]
    assert sagged == pytest.approx(tcp_poses(ARM, NONE, turned), abs=1e-12)
    assert -0.1 < (sagged - tcp_poses(ARM, NONE, q))[0, 2, 3] < -0.01


def test_payload_deepens_sag_and_alone_changes_nothing() -> None:
    alone = packed("payload_error", None, mass_kg=100.0)
    assert np.array_equal(link_poses(ARM, alone, QS), link_poses(ARM, NONE, QS))
    soft = packed("gravity_sag", 2, compliance_rad_nm=1e-6)
    loaded = ParameterSets(soft.joint_parameters, alone.machine_parameters)
    q = np.array([[0.3, 0.2, -0.5, 0.0, 0.5, 0.0]])
    assert tcp_poses(ARM, loaded, q)[0, 2, 3] < tcp_poses(ARM, soft, q)[0, 2, 3] - 1e-3


def test_the_base_tilts_and_leans() -> None:
    tilted = tcp_poses(ARM, packed("base_tilt", None, tilt_rad=0.02, axis=[0.0, 1.0, 0.0]), QS)
    wanted = rotation_about("y", 0.02) @ tcp_poses(ARM, NONE, QS)[:, :3, :3]
    assert tilted[:, :3, :3] == pytest.approx(wanted, abs=1e-12)
    q = np.array([[0.0, 0.2, -0.5, 0.0, 0.5, 0.0]])
    links = link_poses(ARM, packed("base_compliance", None, compliance_rad_nm=1e-6), q)
    lean = rotvec_from_rotation(links[0, 0, :3, :3])
    assert lean[1] > 1e-3  # the arm points along x: it leans about +y
    assert abs(lean[0]) < 1e-9
    assert links[0, -1, 2, 3] < link_poses(ARM, NONE, q)[0, -1, 2, 3]


def test_lengths_and_axes() -> None:
    rows = [DhRow(j.a_m, j.d_m, j.alpha_rad, j.theta_offset_rad) for j in hiab().joints]
    rows[1] = DhRow(rows[1].a_m + 0.01, rows[1].d_m, rows[1].alpha_rad, rows[1].theta_offset_rad)
    longer = tcp_poses(arm_from_dh(rows, ARM.T_flange_tcp), NONE, QS)
    assert tcp_poses(ARM, packed("link_length_error", 2, error_m=0.01, of="a"), QS) == pytest.approx(longer, abs=1e-12)
    base = packed("joint_axis_tilt", 1, tilt_rad=0.03, about="y")
    wanted = tcp_poses(ARM, packed("base_tilt", None, tilt_rad=0.03, axis=[0.0, 1.0, 0.0]), QS)
    assert tcp_poses(ARM, base, QS) == pytest.approx(wanted, abs=1e-12)  # the first axis tilts the whole arm


@pytest.mark.parametrize(
    "effect", [one for one in effects_of("structure") if one.name != "link_flexibility"], ids=lambda one: one.name
)
def test_every_parameter_is_felt_finite_and_neutral_is_exact(effect) -> None:
    joint = 2 if effect.scope == "joint" else None
    base = packed("gravity_sag", 2, compliance_rad_nm=1e-6) if effect.name == "payload_error" else neutral_sets(6)
    nominal = link_poses(ARM, base, QS)
    for option in effect.quantity_choice.options if effect.quantity_choice else ("",):
        for slot in slots_of(effect.name, joint, option):
            for value, same in (
                (slot.neutral_value, True),
                (slot.start_value, False),
                (slot.lower_bound, None),
                (slot.typical_max, None),
            ):
                changed = base.repeated_sets(1)
                changed.put(slot, value)
                poses = link_poses(ARM, changed, QS)
                assert np.isfinite(poses).all()
                assert same is None or np.array_equal(poses, nominal) == same, (slot, value)


def encoder_readings(sets, q_true):
    """Readings (m, n) [rad] at true motor-side angles (m, n): bias, scale and one sine."""
    P = sets.joint_parameters[0]
    wave = P[:, ECC_AMPLITUDE] * np.sin(P[:, ECC_ORDER] * q_true + P[:, ECC_PHASE])
    return q_true * (1.0 + P[:, SCALE]) + P[:, BIAS] + wave


def test_encoders_are_inverted_and_rest_on_either_side_of_their_play() -> None:
    sets = packed("encoder_eccentricity", 2, amplitude_rad=0.03, order=4, phase_rad=0.5)
    sets.joint_parameters[0, 3] = packed("encoder_scale", 4, scale_frac=-0.1).joint_parameters[0, 3]
    assert true_angles(sets, encoder_readings(sets, QS)) == pytest.approx(QS, abs=1e-12)
    assert np.array_equal(true_angles(NONE, QS), QS)
    play = packed("backlash", 2, width_rad=0.01)
    sides = np.zeros(6)
    sides[1] = -1.0
    assert (angles_at_rest(play, QS, sides) - QS)[:, 1] == pytest.approx(-0.005)
    assert np.array_equal(angles_at_rest(play, QS), QS)


def test_bad_arms_are_refused() -> None:
    with pytest.raises(MachineError, match="6 joints"):
        link_poses(ARM, NONE, np.zeros((3, 5)))
    with pytest.raises(MachineError, match="not XML"):
        arm_from_urdf("<robot", "a", "b")
    with pytest.raises(MachineError, match="no link 'elbow'"):
        arm_from_urdf(urdf_text(hiab()), "elbow", "tcp")
    with pytest.raises(MachineError, match="none of"):
        arm_from_urdf(urdf_text(hiab()), "base", "tcp", ["elbow"])
    with pytest.raises(MachineError, match="not in the chain's order"):
        arm_from_urdf(urdf_text(hiab()), "base", "tcp", ["lift", "slew"])


def test_a_urdf_chain_may_rise_and_hold_or_skip_joints() -> None:
    text = urdf_text(hiab())
    forward, _ = arm_from_urdf(text, "base", "tcp")
    names = [f"joint_{k}" for k in range(2)] + [joint.name for joint in hiab().joints]
    padded, _ = arm_from_urdf(text, "base", "tcp", names)
    wide = np.concatenate([RNG.normal(size=(20, 2)), QS], axis=1)
    assert tcp_poses(padded, neutral_sets(8), wide) == pytest.approx(tcp_poses(forward, NONE, QS), abs=1e-12)
    backward, order = arm_from_urdf(text, "tcp", "base")
    assert order == tuple(joint.name for joint in hiab().joints[::-1])
    inverse = np.linalg.inv(tcp_poses(forward, NONE, QS))
    assert tcp_poses(backward, NONE, QS[:, ::-1]) == pytest.approx(inverse, abs=1e-9)
