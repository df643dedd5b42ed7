"""Tables of other systems: names, units and separators as people write them, shown as guesses and never silent."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from typer.testing import CliRunner

from longreach.cli import app
from recording.content import column
from recording.errors import RecordingError
from recording.foreign.assemble import AssembledRecording
from recording.foreign.convert import convert_foreign
from recording.foreign.found import SourceContents
from recording.foreign.mapping import UrdfChain, read_mapping
from recording.foreign.urdf_ends import chain_for
from recording.opening import read_run
from recording.rows import PlcState, TrackerPoint

T = 0.01 * np.arange(400)
REF = np.stack([0.5 * np.sin(T), 0.3 * np.sin(2.0 * T)], axis=1)
ENC = np.stack([0.5 * np.sin(T - 0.05), 0.3 * np.sin(2.0 * T - 0.1)], axis=1)


def yes(_: SourceContents, __: AssembledRecording) -> bool:
    return True


def write(path: Path, header: Sequence[str], table: np.ndarray, separator: str = ",", comma: bool = False) -> Path:
    rows = [separator.join(header), *(separator.join(f"{value:.9f}" for value in row) for row in table)]
    text = "\n".join(rows) + "\n"
    path.write_text(text.replace(".", ",") if comma else text, encoding="utf-8")
    return path


def converted(path: Path, tmp_path: Path, mapping: Path | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    out = tmp_path / f"{path.name}.out"
    convert_foreign(path, out, None, mapping, yes)
    rows = read_run(out).of(PlcState)
    return column(rows, "t_plc_s"), column(rows, "q_ref_rad"), column(rows, "q_rad")


def same(found: tuple[np.ndarray, np.ndarray, np.ndarray], atol: float = 1e-8) -> None:
    assert np.abs(found[0] - T).max() < 1e-6
    assert np.abs(found[1] - REF[:, : found[1].shape[1]]).max() < atol
    assert np.abs(found[2] - ENC[:, : found[2].shape[1]]).max() < atol


def test_a_log_of_a_universal_robot_counts_from_0(tmp_path: Path) -> None:
    names = ["timestamp", "target_q_0", "target_q_1", "actual_q_0", "actual_q_1", "actual_current_0"]
    same(converted(write(tmp_path / "ur.csv", names, np.c_[T + 1000.0, REF, ENC, T]), tmp_path))


def test_degrees_milliseconds_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    names = ["Zeit [ms]", "Soll Gelenk1 [°]", "Ist Gelenk1 [°]"]
    table = np.c_[1e3 * T, np.rad2deg(REF[:, 0]), np.rad2deg(ENC[:, 0])]
    same(converted(write(tmp_path / "de.csv", names, table, ";", comma=True), tmp_path))


def test_an_export_of_twincat_scope_with_two_sample_times(tmp_path: Path) -> None:
    keys = (
        ("Name", "a", "b", "c"),
        ("Data-Type", "REAL64", "REAL64", "REAL64"),
        ("SampleTime[ms]", "10", "10", "20"),
        ("SymbolName", "MAIN.fbArm.q_ref[1]", "MAIN.fbArm.q[1]", "MAIN.fbArm.q[2]"),
        ("Unit", "rad", "rad", "rad"),
    )
    lines = ["Name\tProject", "Starttime of export\t132959973843760000\tMonday", ""]
    lines += [f"{key}\t{first}\t{second}\t{key}\t{third}" for key, first, second, third in keys]
    lines.append("")
    for k in range(len(T)):
        slow = [str(20 * k), f"{ENC[2 * k, 1]:.9f}"] if 2 * k < len(T) else ["", ""]
        lines.append("\t".join([str(10 * k), f"{REF[k, 0]:.9f}", f"{ENC[k, 0]:.9f}", *slow]).replace(".", ","))
    path = tmp_path / "scope.csv"
    path.write_text("\n".join([*lines, "EOF"]), encoding="utf-8")
    t, ref, enc = converted(path, tmp_path)
    same((t, ref[:, :1], enc[:, :1]))
    assert np.nanmax(np.abs(enc[:-1, 1] - ENC[:-1, 1])) < 1e-4  # on lines between its own samples


def test_a_matlab_structure_and_its_newer_file_form(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"data": {"time": T, "q": ENC, "q_des": REF}, "note": "x"})
    same(converted(path, tmp_path))
    newer = tmp_path / "newer.mat"
    newer.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(600))
    with pytest.raises(RecordingError, match="save it"):
        convert_foreign(newer, tmp_path / "never", None, None, yes)


def test_lists_in_parquet_are_joints(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    lists = {"observation.state": np.rad2deg(ENC).tolist(), "action": np.rad2deg(REF).tolist()}
    path = tmp_path / "episode.parquet"
    parquet.write_table(pyarrow.table({"timestamp": T, **lists}), path)
    same(converted(path, tmp_path))


def test_a_mapping_file_says_what_names_do_not(tmp_path: Path) -> None:
    path = write(tmp_path / "own.csv", ["k", "alpha", "beta", "px", "py", "pz"], np.c_[T, ENC[:, 0], REF[:, 0], ENC, T])
    mapping = tmp_path / "mapping.toml"
    wanted = [("k", "time", "s"), ("alpha", "q", "deg"), ("beta", "q_ref", "deg")]
    text = "".join(
        f'[[column]]\nname = "{name}"\nsignal = "{signal}"\nunit = "{unit}"\n'
        + ("joint = 1\n" if unit == "deg" else "")
        for name, signal, unit in wanted
    )
    text += "".join(f'[[column]]\nname = "p{axis}"\nsignal = "{axis}"\nunit = "mm"\npoint = "tip"\n' for axis in "xyz")
    mapping.write_text(text, encoding="utf-8")
    _, ref, enc = converted(path, tmp_path, mapping)
    assert np.abs(np.rad2deg(enc[:, 0]) - ENC[:, 0]).max() < 1e-8
    assert np.abs(np.rad2deg(ref[:, 0]) - REF[:, 0]).max() < 1e-8
    points = read_run(tmp_path / "own.csv.out").of(TrackerPoint)
    assert points[-1].point == "tip"
    assert points[-1].z_m == pytest.approx(1e-3 * T[-1])
    mapping.write_text(text.replace('"mm"', '"inch"'), encoding="utf-8")
    with pytest.raises(RecordingError, match="unit 'inch' does not fit a column of x; give one of"):
        convert_foreign(path, tmp_path / "never", None, mapping, yes)


def test_guesses_have_to_be_confirmed(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", ["t", "q1", "q1_ref"], np.c_[T, ENC[:, 0], REF[:, 0]])
    done = CliRunner().invoke(app, ["recording", "convert", str(path), str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "guessed and not confirmed: t, q1, q1_ref" in done.output
    done = CliRunner().invoke(app, ["recording", "convert", str(path), str(tmp_path / "out"), "--yes"])
    assert done.exit_code == 0, done.output


def test_the_guesses_are_written_also_where_they_are_not_enough(tmp_path: Path) -> None:
    path, mapping = write(tmp_path / "log.csv", ["a", "q1"], np.c_[T, ENC[:, 0]]), tmp_path / "mapping.toml"
    call = ["recording", "convert", str(path), str(tmp_path / "out"), "--mapping-out", str(mapping)]
    done = CliRunner().invoke(app, call)
    assert done.exit_code == 2
    assert "no column of times" in done.output
    written = read_mapping(mapping)
    assert [(column.name, column.signal) for column in written.column] == [("a", "ignored"), ("q1", "q")]
    mapping.write_text(mapping.read_text("utf-8").replace('"ignored"', '"time"\nunit = "s"'), encoding="utf-8")
    _, _, enc = converted(path, tmp_path, mapping)
    assert len(enc) == len(T)


@pytest.mark.parametrize(("n_joints", "tip"), [(2, "l2"), (3, "f1")])
def test_a_finger_is_a_joint_only_where_as_many_joints_were_recorded(tmp_path: Path, n_joints: int, tip: str) -> None:
    text = """<robot name="arm"><link name="base"/><link name="l1"/><link name="l2"/><link name="f1"/><link name="f2"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><axis xyz="0 0 1"/></joint>
<joint name="finger1" type="prismatic"><parent link="l2"/><child link="f1"/><axis xyz="0 1 0"/></joint>
<joint name="finger2" type="prismatic"><parent link="l2"/><child link="f2"/><axis xyz="0 1 0"/></joint></robot>"""
    assert chain_for(text, (), UrdfChain(), n_joints).tip_link == tip


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (bytes(range(256)) * 10, "not text at all"),
        (b"t,q1\n", "no row of numbers"),
        (b"0.1,0.2\n0.2,0.3\n", "start with a row of names"),
        (b"a,b\n0.1,0.2\n0.2,0.3\n", "no column of times"),
        (b"t,current\n0.1,0.2\n0.2,0.3\n", "no column is a joint's position"),
    ],
)
def test_tables_that_are_none_are_refused_with_a_reason(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=said):
        convert_foreign(path, tmp_path / "never", None, None, yes)


def test_times_that_start_again_are_episodes_and_lose_no_row(tmp_path: Path) -> None:
    table = np.column_stack([T % 1.0, REF, ENC])  # four episodes of 1 s
    names = ["timestamp", "action_0", "action_1", "state_0", "state_1"]
    t_s, q_ref, q = converted(write(tmp_path / "episodes.csv", names, table), tmp_path)
    assert len(t_s) == len(T)
    assert np.sum(np.diff(t_s) > 5.0) == 3
    assert np.abs(q_ref - REF).max() < 1e-8
    assert np.abs(q - ENC).max() < 1e-8


def test_desired_currents_are_no_references(tmp_path: Path) -> None:
    table = np.column_stack([T, ENC, 3.0 * ENC])
    names = ["t", "q_0", "q_1", "i_des_0", "i_des_1"]
    out = tmp_path / "out"
    done = convert_foreign(write(tmp_path / "ur.csv", names, table), out, None, None, yes)
    assert not done.source_contents.signals_of("reference")
    assert [entry.name for entry in done.source_contents.entries if entry.use == "ignored"] == ["i_des_0", "i_des_1"]


def test_a_command_that_does_not_rest_at_zero_is_refused(tmp_path: Path) -> None:
    duty = 7.5 + 2.0 * np.cos(T)[:, None]  # a servo's pulse: its rest is 7.5 %
    table = np.column_stack([T, 0.5 * np.sin(T), duty])
    with pytest.raises(
        RecordingError, match=r"'u_1' \(u of joint 1\) is never 0.*subtract what the command is at rest"
    ):
        converted(write(tmp_path / "duty.csv", ["t", "q_1", "u_1"], table), tmp_path)
    one_way = np.column_stack([T, 0.1 * T, duty])
    assert len(converted(write(tmp_path / "one_way.csv", ["t", "q_1", "u_1"], one_way), tmp_path)[0]) == len(T)
