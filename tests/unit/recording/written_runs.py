"""Runs that the tests of recordings write and compare."""

from dataclasses import fields
from pathlib import Path

from recording.content import Attachment
from recording.foxglove import FramePose
from recording.rows import NAN, Floats, MarkerCorners, OdometryRow, PlcState, Row, Sent
from recording.run import RunInfo, Segment
from recording.writer import QUEUED_IMAGES_MAX, RunWriter

ROOT = Path(__file__).parents[3]

MACHINE_TOML = (ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8")
SECOND_NS = 1_000_000_000


def plc_state(number: int) -> PlcState:
    joints: Floats = tuple(0.1 * joint + 1e-3 * number for joint in range(6))
    return PlcState(
        t_plc_s=100.0 + 0.01 * number,
        seq_received=number,
        q_ref_rad=joints,
        qd_ref_rad_s=joints,
        q_rad=joints,
        u_frac=joints,
        p_a_pa=joints,
        p_b_pa=joints,
        p_supply_pa=2.1e7,
        t_oil_c=NAN,
        plc_state="ARMED",
    )


def run_info() -> RunInfo:
    segments = (Segment("a", "repeat", 100.0, 100.5, "a"), Segment("b", "hold", 100.5, 101.0))
    return RunInfo('quote " and ä', "2026-01-02T03:04:05+00:00", 7, -95.5, 12.25, 1.7e9, segments)


def write(path: Path, count: int = 100) -> Path:
    attachments = [Attachment("machine.toml", "application/toml", MACHINE_TOML.encode())]
    writer = RunWriter(path, run_info(), attachments, [("seed", "7")])
    corners = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.5)
    for number in range(count):
        t_ns = SECOND_NS + number * 10_000_000
        writer.row(plc_state(number), t_ns, t_ns - 1000)
        writer.row(Sent(4.0 + 0.01 * number, number, (0.0,) * 6), t_ns)
        if number % 10 == 0:
            writer.row(MarkerCorners(0.01 * number, "left", 10, *corners), t_ns)
            writer.row(OdometryRow(0.01 * number, 0.0, 0.1, 0.2, 1.0, 0.0, 0.0, 0.0, "ok", 120), t_ns)
            writer.image(b"jpeg" * 100, t_ns, t_ns)
    writer.log("warning", "careful", SECOND_NS)
    writer.transforms([FramePose("base", "tcp", (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))], SECOND_NS)
    report = writer.close(run_info())
    assert report.error == ""
    assert report.images_dropped == 0 or count > 10 * QUEUED_IMAGES_MAX
    return path


def same(first: Row, second: Row) -> bool:
    pairs = [(getattr(first, each.name), getattr(second, each.name)) for each in fields(first)]
    return all(a == b or (a != a and b != b) for a, b in pairs)
