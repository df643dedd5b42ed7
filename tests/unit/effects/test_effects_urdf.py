"""A URDF's chain: what lies on it is read or refused by name, what lies beside it does not matter."""

import numpy as np
import pytest

from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.urdf_xml import urdf_chain
from machine.errors import MachineError

CHAIN = """<robot name="r"><link name="base"/><link name="boom"><inertial><mass value="40"/><origin xyz="1 0 0"/>
</inertial></link><link name="tip"/><link name="wheel"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="boom"/><origin xyz="0 0 1" rpy="0 0 0"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1.5"/></joint>
<joint name="j2" type="prismatic"><parent link="boom"/><child link="tip"/><axis xyz="1 0 0"/><limit upper="2"/></joint>
<joint name="loose" type="floating"><parent link="base"/><child link="wheel"/><origin xyz="0 0"/></joint></robot>"""


def test_limits_and_masses_are_the_urdfs_own() -> None:
    first, second = urdf_chain(CHAIN, "base", "tip")
    assert (first.lower_limit, first.upper_limit, first.child_mass_kg) == (-1.0, 1.5, 40.0)
    assert (second.lower_limit, second.upper_limit, second.child_mass_kg) == (0.0, 2.0, None)
    turned = urdf_chain(CHAIN.replace('lower="-1" upper="1.5"', 'effort="9"'), "base", "tip")[0]
    assert (turned.lower_limit, turned.upper_limit) == (-np.inf, np.inf)


def test_an_empty_first_line_is_no_fault() -> None:
    assert len(urdf_chain("\ufeff\n  <?xml version='1.0'?>\n" + CHAIN, "base", "tip")) == 2


def test_gravity_may_point_anywhere() -> None:
    arm, _ = arm_from_urdf(CHAIN, "base", "tip", gravity=np.array([9.81, 0.0, 0.0]))
    assert arm.gravity.tolist() == [9.81, 0.0, 0.0]


def test_a_wheel_beside_the_chain_does_not_matter() -> None:
    assert arm_from_urdf(CHAIN, "base", "tip")[1] == ("j1", "j2")
    with pytest.raises(MachineError, match="joint 'loose' has type 'floating'; on the chain give revolute"):
        arm_from_urdf(CHAIN, "wheel", "tip")


def test_a_joint_that_follows_another_one_is_refused_unless_it_is_measured() -> None:
    boom = CHAIN.replace('<limit upper="2"/>', '<mimic joint="j1" multiplier="1"/><limit upper="2"/>')
    assert boom != CHAIN
    for names in (None, ("j1",)):
        with pytest.raises(MachineError, match=r"joint 'j2' mimics 'j1'.*record 'j2' as a joint of its own"):
            arm_from_urdf(boom, "base", "tip", names)
    assert arm_from_urdf(boom, "base", "tip", ("j1", "j2"))[1] == ("j1", "j2")
    elsewhere = boom.replace('mimic joint="j1"', 'mimic joint="j9"')  # a leader that is not on the chain
    assert arm_from_urdf(elsewhere, "base", "tip")[1] == ("j1", "j2")


@pytest.mark.parametrize(
    ("given", "spoilt", "told"),
    [
        ('xyz="0 0 1"', 'xyz="0 0"', "joint 'j1': xyz='0 0' has 2 numbers; give 3 finite ones"),
        ('rpy="0 0 0"', 'rpy="0 0"', "joint 'j1': rpy='0 0' has 2 numbers; give 3 finite ones"),
        ('rpy="0 0 0"', 'rpy="0 0 nan"', "joint 'j1': rpy='0 0 nan' has 3 numbers; give 3 finite ones"),
        ('rpy="0 0 0"', 'rpy="0,0,0"', "joint 'j1': rpy='0,0,0' holds something that is not a number"),
        ('<axis xyz="0 1 0"', '<axis xyz="0 1"', "joint 'j1': xyz='0 1' has 2 numbers"),
        ('lower="-1"', 'lower=""', "joint 'j1': lower='' has 0 numbers; give 1 finite ones"),
        ('value="40"', 'value=""', "link 'boom': inertial: value='' has 0 numbers; give 1 finite ones"),
        ('value="40"', 'value="-4"', "link 'boom': inertial: value=-4 is below 0 kg"),
        ('xyz="1 0 0"/>\n', 'xyz="1"/>\n', "link 'boom': inertial: xyz='1' has 1 numbers"),
    ],
)
def test_numbers_that_are_none_are_told_with_their_joint_or_link(given: str, spoilt: str, told: str) -> None:
    text = CHAIN.replace(given, spoilt, 1)
    assert text != CHAIN
    with pytest.raises(MachineError) as error:
        arm_from_urdf(text, "base", "tip")
    assert told in str(error.value)
