"""A machine file with a URDF: gravity, masses, limits count, names that do not fit are told, the named file is read."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.errors import DiagnosisError
from diagnosis.log.nominal import Nominal, nominal_of
from diagnosis.log.urdf_files import UrdfFiles
from diagnosis.reading.read import Read, examine_recording, read_for_diagnosis
from recording.content import Attachment, Recording
from recording.folder import write_folder
from recording.rows import StaticPoint
from recording.run import RunInfo

URDF = """<robot name="r"><link name="base"/><link name="boom"><inertial><mass value="40"/><origin xyz="1 0 0"/>
</inertial></link><link name="tip"><inertial><mass value="10"/></inertial></link><link name="head"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1.5"/></joint>
<joint name="j2" type="prismatic"><parent link="boom"/><child link="tip"/><origin xyz="2 0 0"/><axis xyz="1 0 0"/>
<limit upper="2"/></joint>
<joint name="neck" type="revolute"><parent link="base"/><child link="head"/></joint></robot>"""
HEAD = '[machine]\nname = "x"\n[urdf]\nfile = "a.urdf"\nbase_link = "base"\ntip_link = "tip"\n'
JOINTS = '[[joint]]\nname = "j1"\n[[joint]]\nname = "j2"\n'


def files(**texts: str) -> UrdfFiles:
    return UrdfFiles(tuple(attached(f"{name}.urdf", text) for name, text in texts.items()))


def attached(name: str, text: str) -> Attachment:
    return Attachment(name, "application/xml", text.encode())


def nominal(toml: str, urdf: str = URDF) -> Nominal:
    return nominal_of(toml, files(a=urdf))


def arm_of(toml: str, urdf: str = URDF):
    arm = nominal(toml, urdf).arm
    assert arm is not None
    return arm


def told(toml: str, urdf: str = URDF) -> list[tuple[str, str, str]]:
    return [(one.code, one.severity, one.text) for one in nominal(toml, urdf).findings]


def test_gravity_and_masses_of_the_machine_file_count() -> None:
    hung = HEAD.replace("[urdf]", "gravity_base_m_s2 = [9.81, 0, 0]\n[urdf]")
    arm = arm_of(hung + '[[joint]]\nname = "j1"\nmass_kg = 99\n[[joint]]\nname = "j2"\ncom_m = [0.5, 0, 0]\n')
    assert arm.gravity.tolist() == [9.81, 0.0, 0.0]
    assert arm.mass.tolist() == [99.0, 10.0]
    assert arm.com.tolist() == [[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    assert arm_of(HEAD + JOINTS).mass.tolist() == [40.0, 10.0]


def test_a_load_that_nobody_gives_is_absent() -> None:
    assert nominal(HEAD + JOINTS).why_absent("load") == ""
    light = URDF.replace('<inertial><mass value="10"/></inertial>', "")
    assert "mass of the link that j2 moves" in nominal(HEAD + JOINTS, light).why_absent("load")
    assert nominal(HEAD + JOINTS + "mass_kg = 5\n", light).why_absent("load") == ""


def test_limits_are_the_files_and_else_the_urdfs() -> None:
    found = nominal(HEAD + JOINTS)
    assert found.joint_slides == (False, True)
    assert (found.q_min.tolist(), found.q_max.tolist()) == ([-1.0, 0.0], [1.5, 2.0])
    own = nominal(
        HEAD + '[[joint]]\nname = "j1"\nq_max_deg = 45\n[[joint]]\nname = "j2"\nq_min_m = 0.5\nq_max_m = 1.5\n'
    )
    assert own.q_min == pytest.approx([-1.0, 0.5])
    assert own.q_max == pytest.approx([np.pi / 4.0, 1.5])
    (one,) = told(HEAD + JOINTS + "q_min_deg = 10\n")
    assert one == ("unknown_key", "problem", "joint 2 (j2) slides: q_min_deg was not read; give it in m")


@pytest.mark.parametrize(
    ("given", "spoilt", "why"),
    [
        ('"j2"', '"j2"\ntype = "revolute"', "joint 2 (j2): type = 'revolute', but the URDF's is prismatic"),
        ('"j2"', '"j2"\ntype = "linear"', "joint 2: type = 'linear'; give 'revolute' or 'prismatic'"),
        ('"j2"', '"j1"', "[[joint]] names ['j1', 'j1'] repeat"),
        ('[[joint]]\nname = "j1"', "[[joint]]\n[[joint]]", "3 [[joint]], not all with a name, but 2 URDF joints move"),
        ('"j2"', '"j2"\nq_min_m = 3.0', "q_min_m = 3 is not below q_max_m = 2 of the URDF"),
    ],
)
def test_what_cannot_belong_together_is_refused(given: str, spoilt: str, why: str) -> None:
    with pytest.raises(DiagnosisError) as error:
        nominal((HEAD + JOINTS).replace(given, spoilt))
    assert why in str(error.value)


def test_a_misspelt_joint_does_not_freeze_one_without_a_word() -> None:
    assert told(HEAD + JOINTS) == []
    strange, held = told(HEAD + JOINTS.replace("j2", "J2"))
    assert strange == (
        "machine_mismatch",
        "problem",
        "joint 2 (J2) is not in the URDF and moves nothing; did you mean 'j2'?",
    )
    assert held[:2] == ("machine_mismatch", "problem")
    assert "'j2' lies on the chain, has no [[joint]] of its name and is held at 0" in held[2]


def test_joints_may_be_held_and_may_lie_elsewhere() -> None:
    (held,) = told(HEAD + '[[joint]]\nname = "j1"\n')
    assert held[:2] == ("machine_mismatch", "note")
    (neck,) = told(HEAD + JOINTS + '[[joint]]\nname = "neck"\n')
    assert neck == ("machine_mismatch", "note", "joint 3 (neck) is not on the URDF's chain and moves nothing")


def test_a_second_geometry_is_said_to_be_unread() -> None:
    (one,) = told(HEAD + JOINTS + "a_m = 2.0\nd_m = 0.0\n")
    assert one[:2] == ("unknown_key", "note")
    assert one[2].startswith("[[joint]] a_m, d_m: not read, the geometry is the URDF's")


def test_the_urdf_that_is_named_is_read_and_no_other() -> None:
    longer = URDF.replace('xyz="2 0 0"', 'xyz="9 0 0"')
    for name in ("a.urdf", "meshes/a.urdf", "C:\\\\arm\\\\a.urdf"):
        found = nominal_of(HEAD.replace("a.urdf", name) + JOINTS, files(a=URDF, z=longer)).arm
        assert found is not None
        assert found.before[1, 0, 3] == 2.0
    without = nominal_of(HEAD + JOINTS, files(b=URDF, z=longer))
    assert without.arm is None
    assert "'a.urdf' is not in the recording; there is b.urdf, z.urdf" in without.why_absent("structure")
    assert "put it there" in nominal_of(HEAD + JOINTS).why_absent("structure")


def poses(urdf: str = "") -> Recording:
    rows = tuple(
        StaticPoint(k, (0.1 * k - 0.4, 0.1 * k), "p", 2.0 + 0.1 * k, 0.0, 0.01 * k * k) for k in range(9)
    )  # nobody judges them here
    kept = (attached("z.urdf", urdf),) if urdf else ()
    return Recording("folder", RunInfo("x"), HEAD + JOINTS + "[points]\np = { joint = 2 }\n", rows, attachments=kept)


def test_a_urdf_beside_the_machine_file_that_is_given_is_found(tmp_path: Path) -> None:
    write_folder(poses(), tmp_path / "run")
    (tmp_path / "mine.toml").write_text(poses().machine_toml, encoding="utf-8")
    result = read_for_diagnosis(tmp_path / "run", tmp_path / "mine.toml")
    assert not result.has_judgeable_stage
    assert "not in the recording or next to the machine file; put it there" in fatal(result)
    (tmp_path / "a.urdf").write_text(URDF, encoding="utf-8")
    result = read_for_diagnosis(tmp_path / "run", tmp_path / "mine.toml")
    assert result.nominal_machine is not None
    assert result.nominal_machine.arm is not None


def test_a_spoilt_urdf_is_a_finding_with_its_joint() -> None:
    spoilt = attached("a.urdf", URDF.replace('xyz="2 0 0"', 'xyz="2 0"'))
    made = poses()
    result = examine_recording(
        Recording("folder", made.run_info, made.machine_toml, made.rows, attachments=(spoilt,)), Path("x")
    )
    assert "joint 'j2': xyz='2 0' has 2 numbers" in fatal(result)


def fatal(result: Read) -> str:
    (one,) = [one for one in result.findings if one.severity == "fatal"]
    return str(one)


@pytest.mark.parametrize("data", ["<robot/>".encode("utf-16"), "<!-- \u00fc --><robot/>".encode("latin-1")])
@pytest.mark.parametrize("recorded", [False, True])
def test_a_urdf_that_is_not_utf_8_is_refused_with_its_encoding(tmp_path, data, recorded):
    (tmp_path / "a.urdf").write_bytes(data)
    files = UrdfFiles((Attachment("a.urdf", "application/xml", data),)) if recorded else UrdfFiles((), tmp_path)
    with pytest.raises(DiagnosisError, match=r"URDF a\.urdf cannot be read: .*save it as UTF-8"):
        files.urdf_text("a.urdf")
    (tmp_path / "b.urdf").write_bytes(b"\xef\xbb\xbf<robot/>")
    assert UrdfFiles((), tmp_path).urdf_text("b.urdf") == "<robot/>"
