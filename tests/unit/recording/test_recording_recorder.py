"""The server's recorder: everything it is told lands in one file per run."""

import json
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter

from machine.description import parse_machine_toml
from recording.check import check_recording
from recording.opening import read_run
from recording.rows import CalibrationRow, CameraState, Finding, LookRow, MarkerCorners, MarkerPose, PlanRow, PlcState
from server.calibration.contracts import CalibrationStatus, CameraRotationEstimate
from server.camera.contracts import FrameReport
from server.link.contracts import PlcSample
from server.motion.contracts import JointTrajectory, PathPlan, PlanStatus
from server.motion.identification_courses import SegmentMark
from server.recorder import Recorder
from server.vision.contracts import Look, LookStatus, MarkerView, ObjectPose, PairObservation, PoseStatus

ROOT = Path(__file__).parents[3]
MACHINE_TOML = (ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
MACHINE = parse_machine_toml(MACHINE_TOML)
SIX = (0.1, 0.2, -0.3, 0.4, 0.5, -0.6)
MS = 1_000_000


def sample(number: int) -> PlcSample:
    t_plc_ns, latency_ns = 10**12 + number * 10 * MS, (2 + number % 3) * MS
    return PlcSample(
        t_plc_ns,
        t_plc_ns + 7 * 10**9 + latency_ns,
        number,
        *[SIX] * 7,
        pressure_supply_pa=2e7,
        oil_temperature_c=40.0,
        plc_state="ARMED",
        traj_id=1,
        knot_playing=2,
        t_play_ns=3,
        buffer_us=4,
        underruns=0,
        fault_bits=0,
        reject_code=0,
        simulation=True,
    )


def report(number: int) -> FrameReport:
    t_ns = number * 66 * MS
    tool = ObjectPose("tool", PoseStatus.OK, "", np.eye(4), np.eye(6) * 4e-6, (10,), 0.1, float("inf"))
    ooi = ObjectPose("ooi", PoseStatus.NOT_SEEN, "no marker", None, None, (), 0.0, 0.0)
    corners = np.arange(8.0).reshape(4, 2)
    views = (MarkerView(10, corners, None, 0.1, True, ""),)
    seen = PairObservation(t_ns, tool, ooi, views, ("dim",))
    mapped_ns = t_ns + 9 * 10**9
    return FrameReport(
        seen, mapped_ns + 5 * MS, mapped_ns, number, "stereo", None, 15.0, 9.0, 2, ("frozen",), 3.0, b"\xff\xd8", 960
    )


def plan() -> PathPlan:
    knots = np.zeros((3, 6))
    path = JointTrajectory(np.array([0.0, 1.0, 2.0]), knots, knots, knots)
    return PathPlan(
        PlanStatus.OK, "", path, np.eye(4)[None], np.array(SIX), 0.4, 2.0, 0.1, float("inf"), 0.3, np.array(SIX)
    )


@dataclass(frozen=True, slots=True)
class Error:
    z_mm: float
    sigma_deg: float


@dataclass(frozen=True, slots=True)
class MoveRecord:
    before: Error
    after: Error | None
    sigma_mm: tuple[float, ...]
    status: PlanStatus


def move() -> MoveRecord:
    return MoveRecord(Error(3.0, float("nan")), None, (0.1, 0.2), PlanStatus.OK)


def test_a_run_holds_everything_it_was_told(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, MACHINE)
    recorder.sample(sample(0))  # before the run: not recorded
    recorder.start("position-1", '{"mode": "SIM"}', MACHINE_TOML, seed=3)
    assert recorder.recording
    for number in range(100):
        recorder.sample(sample(number))
        if number % 10 == 0:
            recorder.report(report(number))
    recorder.log_event("warning", "oil is cold")
    recorder.record(Look(LookStatus.OK, "", np.eye(4), np.eye(4), None, None, 20, 19, 1, 2, 0.4))
    rotation = CameraRotationEstimate(
        CalibrationStatus.OK, "", "ours", np.eye(3), np.eye(3) * 1e-8, 0.02, 1.5, 3.0, 120, 0.2, 1.3
    )
    recorder.record(rotation)
    recorder.record(plan())
    recorder.record(move(), "first move")
    recorder.result("reached")
    path = recorder.stop()
    assert path is not None
    assert path.name.endswith("-position-1.mcap")
    assert not recorder.recording
    assert recorder.why_not_recording == ""

    recording = read_run(path)
    assert recording.complete
    assert [len(recording.of(kind)) for kind in (PlcState, CameraState, MarkerPose, MarkerCorners)] == [100, 10, 20, 10]
    assert recording.of(PlcState)[7].q_rad == SIX
    assert recording.of(MarkerPose)[0].sigma_translation_m == pytest.approx((2e-3, 2e-3, 2e-3), rel=1e-9)
    assert recording.of(CameraState)[0].warnings == "frozen; dim"
    assert recording.of(LookRow)[0].n_used == 19
    assert recording.of(CalibrationRow)[0].time_offset_s == pytest.approx(0.02, abs=1e-12)
    assert len(recording.of(PlanRow)[0].knot_q_rad) == 18
    found_move, found_result = recording.of(Finding)
    assert found_move.kind == "MoveRecord"
    before = {"z_mm": 3.0, "sigma_deg": None}
    assert json.loads(found_move.json) == {"before": before, "after": None, "sigma_mm": [0.1, 0.2], "status": "ok"}
    assert found_result.text == "reached"
    assert recording.n_images == 10
    assert recording.run_info.seed == 3
    assert recording.run_info.plc_to_pc_offset_s == pytest.approx(7.002, abs=1e-9)
    assert recording.run_info.camera_to_pc_offset_s == pytest.approx(9.0, abs=1e-9)
    assert [segment.kind for segment in recording.run_info.segments] == ["positioning"]
    assert recording.run_info.segments[0].t_end_plc_s == pytest.approx(1000.99, abs=1e-6)
    assert {attachment.name for attachment in recording.attachments} == {"settings.json", "machine.urdf"}
    assert check_recording(path).usable


def test_segments_name_repeats(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, MACHINE, images=False)
    recorder.start("excite", "{}", MACHINE_TOML)
    for repeat in range(2):
        recorder.sample(sample(100 * repeat))
        recorder.begin_segment(f"r{repeat}", "repeat", "r0")
        recorder.sample(sample(100 * repeat + 50))
    recorder.report(report(1))
    path = recorder.stop()
    assert path is not None
    recording = read_run(path)
    assert [(segment.name, segment.repeat_of) for segment in recording.run_info.segments] == [
        ("r0", "r0"),
        ("r1", "r0"),
    ]
    assert recording.run_info.segments[1].t_start_plc_s == pytest.approx(1001.0, abs=1e-9)
    assert recording.n_images == 0


def test_stretches_of_a_trajectory_count_from_one_moment_and_a_cut_repeat_is_none(tmp_path: Path) -> None:
    marks = [SegmentMark(f"repeats {k}", "repeat", 0.25 * k, 0.25 * (k + 1), "repeats") for k in range(3)]
    recorder = Recorder(tmp_path, MACHINE, images=False)
    recorder.start("identify", "{}", MACHINE_TOML)
    recorder.sample(sample(0))
    recorder.begin_marks((*marks, SegmentMark("steps", "steps", 0.5, 9.0), SegmentMark("rest", "hold", 9.0, 10.0)))
    for number in range(1, 61):  # 0.6 s: in the third repeat the machine is stopped
        recorder.sample(sample(number))
    recorder.end_marks()
    path = recorder.stop()
    assert path is not None
    found = [
        (segment.name, segment.t_start_plc_s - 1000.0, segment.t_end_plc_s - 1000.0)
        for segment in read_run(path).run_info.segments
    ]
    wanted = [("repeats 0", 0.0, 0.25), ("repeats 1", 0.25, 0.5), ("steps", 0.5, 0.6)]
    assert [one[0] for one in found] == [one[0] for one in wanted]
    assert np.allclose([one[1:] for one in found], [one[1:] for one in wanted], atol=1e-6)


def test_a_folder_that_cannot_be_written_is_told_not_raised(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    recorder = Recorder(tmp_path / "file", MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    assert "choose a folder" in recorder.why_not_recording
    recorder.sample(sample(0))
    recorder.log_event("info", "nothing is written")
    assert recorder.stop() is None


def test_a_file_that_broke_off_is_told_while_the_run_goes_on(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    recorder.sample(replace(sample(0), seq=2**64))
    deadline_s = time.monotonic() + 5.0
    while not recorder.why_not_recording and time.monotonic() < deadline_s:
        recorder.sample(sample(1))
    assert "seq_received = 18446744073709551616 cannot be written" in recorder.why_not_recording
    assert recorder.recording
    recorder.stop()
    assert "seq_received" in recorder.why_not_recording
    recorder.start("y", "{}", MACHINE_TOML)
    assert recorder.why_not_recording == ""
    recorder.stop()


def test_a_disk_that_is_full_at_the_start_is_told_not_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_args: object, **_kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("recording.writer.McapWriter.add_attachment", full)
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    assert "No space left" in recorder.why_not_recording
    recorder.sample(sample(0))
    assert recorder.stop() is None


def held_up(monkeypatch: pytest.MonkeyPatch, step: str) -> threading.Event:
    """A disk that takes this step of a file only when the event is set."""
    taken, stalled = getattr(McapWriter, step), threading.Event()

    def late(writer: McapWriter, *args: object, **kwargs: object) -> None:
        stalled.wait(30.0)
        taken(writer, *args, **kwargs)

    monkeypatch.setattr(f"recording.writer.McapWriter.{step}", late)
    return stalled


def test_a_disk_that_is_late_at_the_end_holds_nobody_and_is_told_until_it_came(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.recorder.DISK_WAIT_S", 0.05)
    stalled = held_up(monkeypatch, "finish")
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    recorder.sample(sample(0))
    assert recorder.stop() is None
    assert not recorder.recording
    assert "the disk has not taken all of it within 0.05 s" in recorder.why_not_recording
    stalled.set()
    recorder.finish()
    assert recorder.why_not_recording == ""
    (path,) = tmp_path.glob("*.mcap")
    assert read_run(path).complete


def test_a_disk_that_is_late_at_the_begin_holds_nobody_and_gets_all_that_was_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.recorder.DISK_WAIT_S", 0.05)
    stalled = held_up(monkeypatch, "start")
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    assert (recorder.recording, recorder.why_not_recording) == (True, "")
    for number in range(3):
        recorder.sample(sample(number))
    stalled.set()
    recorder.finish()
    (path,) = tmp_path.glob("*.mcap")
    recording = read_run(path)
    assert (recording.complete, len(recording.of(PlcState))) == (True, 3)


def test_a_file_that_could_not_be_made_after_all_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.recorder.DISK_WAIT_S", 0.05)
    stalled, opened = threading.Event(), Path.open

    def full(path: Path, *mode: str, **named: str) -> object:
        if path.suffix != ".mcap":
            return opened(path, *mode, **named)
        stalled.wait(30.0)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "open", full)
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    recorder.sample(sample(0))
    stalled.set()
    recorder.finish()
    assert "No space left on device; choose a folder that can be written" in recorder.why_not_recording
    assert recorder.stop() is None


def test_the_servers_end_waits_for_every_run_that_its_disk_had_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.recorder.DISK_WAIT_S", 0.05)
    stalled = held_up(monkeypatch, "finish")
    recorder = Recorder(tmp_path, MACHINE)
    for name in ("first", "second"):
        recorder.start(name, "{}", MACHINE_TOML)
        recorder.sample(sample(0))
        assert recorder.stop() is None
    stalled.set()
    recorder.finish()
    assert [read_run(path).complete for path in sorted(tmp_path.glob("*.mcap"))] == [True, True]


def test_a_plc_that_was_switched_off_and_on_costs_no_recording(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("incident", "{}", MACHINE_TOML)
    recorder.begin_segment("first", "hold")
    for number in range(50):
        recorder.sample(sample(number))
    for number in range(50):
        late = sample(number)
        recorder.sample(replace(late, t_plc_ns=late.t_plc_ns - 10**12 + 10**9, t_mono_ns=late.t_mono_ns + 10**9))
    path = recorder.stop()
    assert path is not None
    found = read_run(path)
    assert len(found.of(PlcState)) == 100
    assert [segment.name for segment in found.run_info.segments] == ["first"]
    assert found.run_info.segments[0].t_end_plc_s == pytest.approx(1000.49)
    assert "restarted" in " ".join(entry.text for entry in found.log_entries)


@pytest.mark.parametrize("broken", ["plc_row", "report_rows", "finding_row", "urdf_text"])
def test_a_defect_ends_the_recording_with_a_fault_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def defect(*_args: object) -> None:
        raise UnicodeEncodeError("utf-8", "\udcff", 0, 1, "surrogates not allowed")

    with monkeypatch.context() as patched:
        patched.setattr(f"server.recorder.{broken}", defect)
        recorder = Recorder(tmp_path, MACHINE)
        recorder.start("x", "{}", MACHINE_TOML)
        recorder.sample(sample(0))
        recorder.report(report(0))
        recorder.result("done")
        assert recorder.stop() is None
    assert "recording of x ended with an internal error: UnicodeEncodeError" in recorder.why_not_recording
    recorder.start("y", "{}", MACHINE_TOML)
    assert recorder.why_not_recording == ""
    recorder.finish()


def test_a_file_that_is_removed_while_it_is_written_is_a_fault(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, MACHINE)
    recorder.start("x", "{}", MACHINE_TOML)
    recorder.sample(sample(0))
    (path,) = tmp_path.glob("*.mcap")
    path.unlink()
    recorder.finish()
    assert "removed while it was written" in recorder.why_not_recording
