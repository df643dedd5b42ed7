"""ROS bags without ROS: what a bag holds comes out as it went in, and what is wrong with it is said."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("rosbags")

from foreign_logs import ARM, STEP_S, BagMaker, encoders, reference

from diagnosis.reading.read import read_for_diagnosis
from longreach.cli import app
from recording.content import column
from recording.errors import RecordingError
from recording.foreign.assemble import AssembledRecording
from recording.foreign.convert import convert_foreign
from recording.foreign.found import SourceContents
from recording.foreign.ros_bag import RosBag
from recording.opening import read_run
from recording.rows import PlcState, TrackerPoint

ROWS = 300


def yes(_: SourceContents, __: AssembledRecording) -> bool:
    return True


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, encoding="utf-8")
    return path


def full_bag(path: Path, plugin: str, distribution: int = 0) -> Path:
    """Controller state, joint states in another order with a finger, a tracker, and a topic of no use."""
    with BagMaker(path, plugin, distribution) as bag:
        for k in range(ROWS):
            t = k * STEP_S
            finger = [encoders(t)[1], encoders(t)[0], 0.01]
            bag.joint_state("/joint_states", t, ["j2", "j1", "finger"], finger)
            bag.controller_state("/arm_controller/controller_state", t, ["j1", "j2"])
            if k % 10 == 0:
                bag.pose("/vrpn/hand/pose", t, [np.cos(t), 0.0, 0.2])
        text = bag.make("std_msgs/msg/String", data="hello")
        bag.write("/chatter", "std_msgs/msg/String", text, 0.0)
    return path


@pytest.mark.parametrize(("plugin", "distribution"), [("MCAP", 0), ("SQLITE3", 1), ("SQLITE3", 2), ("MCAP", 3)])
def test_a_bag_gives_its_numbers_back_whatever_its_storage_and_distribution(
    tmp_path: Path, urdf: Path, plugin: str, distribution: int
) -> None:
    bag = full_bag(tmp_path / "bag", plugin, distribution)
    done = convert_foreign(bag, tmp_path / "out", urdf, None, yes)
    rows = read_run(tmp_path / "out").of(PlcState)
    t = STEP_S * np.arange(ROWS)
    assert np.abs(column(rows, "t_plc_s") - t).max() < 1e-6
    assert np.abs(column(rows, "q_rad") - np.array([encoders(one) for one in t])).max() < 1e-12
    assert np.abs(column(rows, "q_ref_rad") - np.array([reference(one) for one in t])).max() < 1e-12
    uses = {entry.name: (entry.use, entry.is_guess) for entry in done.source_contents.entries}
    assert uses["/arm_controller/controller_state"] == ("used", False)
    assert uses["/vrpn/hand/pose"] == ("used", True)
    assert uses["/chatter"] == uses["/joint_states"] == ("ignored", False)
    assert len(read_run(tmp_path / "out").of(TrackerPoint)) == ROWS // 10


def test_the_diagnosis_can_judge_a_converted_bag(tmp_path: Path, urdf: Path) -> None:
    convert_foreign(full_bag(tmp_path / "bag", "MCAP"), tmp_path / "out", urdf, None, yes)
    whole = read_for_diagnosis(tmp_path / "out")
    assert whole.has_judgeable_stage, [str(finding) for finding in whole.findings]
    assert whole.nominal_machine is not None
    assert whole.nominal_machine.joint_names == ("j1", "j2")  # the fingers are no part of the arm
    assert whole.nominal_machine.actuators is not None
    assert whole.nominal_machine.actuators.joints[:, 0].tolist() == [2.5, 1.5]


def test_a_velocity_command_becomes_the_share_of_the_fastest(tmp_path: Path, urdf: Path) -> None:
    with BagMaker(tmp_path / "bag", "MCAP") as bag:
        for k in range(ROWS):
            t = k * STEP_S
            bag.joint_state("/joint_states", t, ["j1", "j2"], encoders(t))
            bag.array("/forward_velocity_controller/commands", t - 1e-4, [1.25, -0.75])
    done = convert_foreign(tmp_path / "bag", tmp_path / "out", urdf, None, yes)
    u = column(read_run(tmp_path / "out").of(PlcState), "u_frac")
    assert np.abs(u - [0.5, -0.5]).max() < 1e-12
    assert any("velocity-controlled" in note for note in done.assembled_recording.notes)
    assert [entry.name for entry in done.source_contents.guessed_entries] == ["/forward_velocity_controller/commands"]


def test_nothing_is_guessed_in_silence(tmp_path: Path, urdf: Path) -> None:
    bag, mapping = full_bag(tmp_path / "bag", "MCAP"), tmp_path / "mapping.toml"
    call = ["recording", "convert", str(bag), str(tmp_path / "out"), "--urdf", str(urdf)]
    done = CliRunner().invoke(app, [*call, "--mapping-out", str(mapping)])
    assert done.exit_code == 2
    assert "guessed and not confirmed: /vrpn/hand/pose" in done.output
    assert not (tmp_path / "out").exists()
    done = CliRunner().invoke(app, [*call, "--mapping", str(mapping)])
    assert done.exit_code == 0, done.output


def test_names_that_differ_are_mapped(tmp_path: Path, urdf: Path) -> None:
    with BagMaker(tmp_path / "bag", "SQLITE3") as bag:
        for k in range(ROWS):
            bag.joint_state("/a", k * STEP_S, ["j1", "j2"], encoders(k * STEP_S))
            bag.joint_state("/b", k * STEP_S, ["j1", "j2"], reference(k * STEP_S))
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('[ros]\nencoders = "/a"\nreference = "/b"\n', encoding="utf-8")
    done = convert_foreign(
        tmp_path / "bag", tmp_path / "out", urdf, mapping, lambda found, _: not found.guessed_entries
    )
    assert np.abs(column(read_run(tmp_path / "out").of(PlcState), "q_ref_rad")[-1] - reference(2.99)).max() < 1e-12
    assert done.assembled_recording.q_encoder is not None
    mapping.write_text('[ros]\nencoders = "/c"\n', encoding="utf-8")
    with pytest.raises(RecordingError, match="names topic /c, which is not in the bag: /a, /b"):
        convert_foreign(tmp_path / "bag", tmp_path / "out2", urdf, mapping, yes)
    mapping.write_text('[ros]\nencoder = "/c"\n', encoding="utf-8")
    with pytest.raises(RecordingError, match=r"ros\.encoder: Extra inputs"):
        convert_foreign(tmp_path / "bag", tmp_path / "out2", urdf, mapping, yes)


def test_joints_that_the_urdf_calls_otherwise_are_named_by_the_mapping(tmp_path: Path, urdf: Path) -> None:
    with BagMaker(tmp_path / "bag", "SQLITE3") as bag:
        for k in range(ROWS):
            bag.joint_state("/joint_states", k * STEP_S, ["arm_a", "arm_b"], encoders(k * STEP_S))
    with pytest.raises(RecordingError, match=r"say under \[joint_names\] of the mapping file"):
        convert_foreign(tmp_path / "bag", tmp_path / "out", urdf, None, yes)
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('[joint_names]\narm_a = "j1"\narm_b = "j2"\n', encoding="utf-8")
    convert_foreign(tmp_path / "bag", tmp_path / "out", urdf, mapping, yes)
    assert re.findall(r'name = "(j\d)"', read_run(tmp_path / "out").machine_toml) == ["j1", "j2"]
    mapping.write_text('[joint_names]\narm_c = "j1"\n', encoding="utf-8")
    with pytest.raises(
        RecordingError, match=r"\['arm_c'\] of joint_names were not recorded; recorded are arm_a, arm_b"
    ):
        convert_foreign(tmp_path / "bag", tmp_path / "out2", urdf, mapping, yes)


def test_bags_that_are_none_are_refused_with_a_reason(tmp_path: Path, urdf: Path) -> None:
    def refused(path: Path) -> str:
        with pytest.raises(RecordingError) as caught:
            convert_foreign(path, tmp_path / "never", urdf, None, yes)
        return str(caught.value)

    for ending in ("mcap", "db3", "bag"):
        (tmp_path / f"empty.{ending}").touch()
        (tmp_path / f"noise.{ending}").write_bytes(bytes(range(256)) * 9)
        assert str(tmp_path / f"empty.{ending}") in refused(tmp_path / f"empty.{ending}")
        assert str(tmp_path / f"noise.{ending}") in refused(tmp_path / f"noise.{ending}")
    assert refused(tmp_path / "empty.mcap").endswith("is not an MCAP file: it is empty")
    bag = full_bag(tmp_path / "bag", "SQLITE3")
    shutil.copytree(bag, tmp_path / "cut")
    file = tmp_path / "cut" / "bag.db3"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert "malformed" in refused(tmp_path / "cut")
    (tmp_path / "cut" / "metadata.yaml").write_text(": {{", encoding="utf-8")
    assert "YAML" in refused(tmp_path / "cut") or "metadata" in refused(tmp_path / "cut")
    with BagMaker(tmp_path / "talk", "MCAP") as talk:
        talk.write("/chatter", "std_msgs/msg/String", talk.make("std_msgs/msg/String", data="x"), 0.0)
    assert "no joint positions" in refused(tmp_path / "talk")
    assert "/chatter" in refused(tmp_path / "talk")


def test_a_cut_mcap_bag_is_used_up_to_there(tmp_path: Path) -> None:
    bag = full_bag(tmp_path / "bag", "MCAP")
    file = bag / "bag.mcap"
    whole = RosBag(bag)
    count = sum(1 for _ in whole)
    assert not whole.cut
    data = bytearray(file.read_bytes())
    place = len(data) // 2
    data[place : place + 400] = bytes(400)
    file.write_bytes(bytes(data))
    cut = RosBag(bag)
    assert sum(1 for _ in cut) < count
    assert cut.cut
    assert cut.notes


def test_a_message_of_an_unknown_type_is_said_and_the_rest_is_used(tmp_path: Path, urdf: Path) -> None:
    with BagMaker(tmp_path / "bag", "SQLITE3") as bag:
        kind = "sensor_msgs/msg/JointState"
        for k in range(ROWS):
            bag.joint_state("/joint_states", k * STEP_S, ["j1", "j2"], encoders(k * STEP_S))
        broken = bag._writer.add_connection("/broken_states", kind, typestore=bag.store)
        bag._writer.write(broken, 1_700_000_001_000_000_000, b"\x00\x01\x00\x00" + b"\xff" * 40)
    done = convert_foreign(tmp_path / "bag", tmp_path / "out", urdf, None, yes)
    why = {entry.name: entry.reason for entry in done.source_contents.entries}
    assert "does not match its type" in why["/broken_states"]


def test_joint_states_without_names_are_refused_or_named_by_the_mapping(tmp_path: Path, urdf: Path) -> None:
    with BagMaker(tmp_path / "bag", "SQLITE3") as bag:
        for k in range(ROWS):
            bag.joint_state("/servo/state", k * STEP_S, [], encoders(k * STEP_S))
    with pytest.raises(RecordingError, match=r"name no joints: give names for its 2 numbers as \[ros\] encoder_joints"):
        convert_foreign(tmp_path / "bag", tmp_path / "none", urdf, None, yes)
    mapping = tmp_path / "map.toml"
    mapping.write_text('[ros]\nencoder_joints = ["j1", "j2"]\n', encoding="utf-8")
    convert_foreign(tmp_path / "bag", tmp_path / "out", urdf, mapping, yes)
    q_rad = column(read_run(tmp_path / "out").of(PlcState), "q_rad")
    assert np.abs(q_rad - [encoders(k * STEP_S) for k in range(len(q_rad))]).max() < 1e-8


def test_a_pointer_of_git_lfs_and_a_wrong_path_say_what_to_do(tmp_path: Path) -> None:
    pointer = tmp_path / "a.bag"
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="git lfs pull"):
        list(RosBag(pointer))
    with pytest.raises(RecordingError, match="check its path"):
        list(RosBag(tmp_path / "no.bag"))
