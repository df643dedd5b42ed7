"""A drawn machine with the fine plant in virtual time that records what the server would of an identification."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, biased
from benchmarks.reproduce.fast_cell import FastCell
from benchmarks.reproduce.fine_machine import NOTE_EVERY_MS, FineMachine
from benchmarks.reproduce.noise_model import CornerNoise, NoiseModel
from benchmarks.reproduce.true_corners import EYES, TrueView
from machine.rotations import Array
from recording.content import Recording
from recording.folder import write_folder
from recording.rows import NAN, MarkerCorners, PlcState, Row
from recording.run import RunInfo, Segment, SegmentKind
from server.jobs.requests import BeginSegment, EndSegment, Move, Request
from sim_plc.world import World, rng_for

T_PLC_ZERO_S = 100.0
CAMERA_HZ = 15.0
STILL_M = 1e-3  # a corner's own error stays while the tool does
LATER_MS = 10  # between two poses that say how fast a corner moves while the rows are read out
NONE = (NAN,) * 6


class RecordedMachine(FineMachine):
    """As the fine machine; reference and valves are noted as well."""

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.rows: list[tuple[float, Array, Array, Array, Array]] = []

    def _follow(self, reference: Array) -> None:
        for q_ref in reference:
            super()._follow(q_ref[None])
            if self._ms % NOTE_EVERY_MS == 0:
                at = self._rows[-1]
                self.rows.append((at[0], at[1], q_ref.copy(), self._valves.copy(), at[2]))


@dataclass(slots=True)
class RecordedCell(FastCell):
    """Answers the identification's requests, and keeps its segments."""

    segments: list[Segment] = field(default_factory=list)
    _open: tuple[str, SegmentKind, float] | None = None

    def perform(self, request: Request) -> object:
        """The reply to one request."""
        match request:
            case BeginSegment():
                self._open = request.name, request.kind, self.machine.t_s
                return None
            case EndSegment():
                if self._open is not None:
                    name, kind, start_s = self._open
                    self.segments.append(Segment(name, kind, T_PLC_ZERO_S + start_s, T_PLC_ZERO_S + self.machine.t_s))
                self._open = None
                return None
            case Move():
                start_s = T_PLC_ZERO_S + self.machine.t_s
                self._move(request)
                self.segments += [
                    Segment(mark.name, mark.kind, start_s + mark.start_s, start_s + mark.end_s, mark.repeat_of)
                    for mark in request.segment_marks
                ]
                return None
        return FastCell.perform(self, request)


def recorded_cell(world: World, noise: NoiseModel) -> RecordedCell:
    """A cell of a world."""
    rng = rng_for(world.seed, "identify")
    camera = FastCamera(world, noise, rng)
    return RecordedCell(world, RecordedMachine(world), camera, noise, rng, world.camera.latency_s)


def write_recording(cell: RecordedCell, machine_text: str, folder: Path, t_from_s: float = 0.0) -> None:
    """What happened since a time as a folder of CSV files, as the server's recorder would have it."""
    machine = cell.machine
    if not isinstance(machine, RecordedMachine):
        raise TypeError("the cell's machine keeps no rows")
    noted = [row for row in machine.rows if row[0] >= t_from_s]
    rows: list[Row] = [_plc_row(*row[:4]) for row in noted]
    rows += _corner_rows(cell, noted)
    late_s = cell.world.camera.latency_s - cell.world.camera.clock_offset_s
    run = RunInfo(
        name=f"identify-{cell.world.preset}-{cell.world.seed}",
        seed=cell.world.seed,
        plc_to_pc_offset_s=0.0,
        camera_to_pc_offset_s=late_s,
        segments=tuple(segment for segment in cell.segments if segment.t_start_plc_s >= T_PLC_ZERO_S + t_from_s),
    )
    write_folder(Recording("folder", run, machine_text, tuple(rows)), folder)


def _plc_row(t_s: float, q: Array, q_ref: Array, valves: Array) -> PlcState:
    ref, enc, u = (tuple(values.tolist()) for values in (q_ref, q, valves))
    return PlcState(T_PLC_ZERO_S + t_s, -1, ref, NONE, enc, u, NONE, NONE, NAN, NAN)


def _corner_rows(cell: RecordedCell, noted: list[tuple[float, Array, Array, Array, Array]]) -> Iterator[MarkerCorners]:
    """Every marker in every picture: true corners, the shutter's rows, and the fitted noise."""
    truth, view, stereo = cell.world.camera, TrueView(cell.world), cell.noise.stereo
    own = rng_for(cell.world.seed, "tool corner bias")
    tool = {
        (marker.marker_id, eye): own.standard_normal((4, 2)) for marker in cell.world.scene.tool_markers for eye in EYES
    }
    lasting: dict[tuple[int, str], tuple[Array, Array]] = {}
    every = round(1e3 / CAMERA_HZ / NOTE_EVERY_MS)
    later = LATER_MS // NOTE_EVERY_MS
    for k in range(0, len(noted) - later, every):
        at, after = noted[k][4], noted[k + later][4]
        moving = float(np.linalg.norm(after[:3, 3] - at[:3, 3])) > 1e-5
        seen = view.corners(at)
        soon = {marker.marker_id: marker for marker in view.corners(after)} if moving else {}
        for marker in seen:
            noise: CornerNoise = stereo.tool if marker.on == "tool" else stereo.ooi
            for eye, px in (("left", marker.left_px), ("right", marker.right_px)):
                if px is None:
                    continue
                next_px = getattr(soon.get(marker.marker_id), f"{eye}_px", None)
                if next_px is not None:
                    share = px[:, 1:] / (truth.left.height_px - 1.0) - 0.5
                    px = px + (next_px - px) * share * truth.readout_s / (1e-3 * LATER_MS)
                bias = tool.get((marker.marker_id, eye)) if marker.on == "tool" else None
                if bias is None:
                    drawn, where = lasting.get((marker.marker_id, eye), (np.zeros((4, 2)), np.full(3, np.inf)))
                    if not np.linalg.norm(at[:3, 3] - where) < STILL_M:
                        drawn, where = cell.rng.standard_normal((4, 2)), at[:3, 3]
                    lasting[(marker.marker_id, eye)] = drawn, where
                    bias = drawn
                found = biased(px, noise) + noise.look_px * bias + noise.frame_px * cell.rng.standard_normal((4, 2))
                stamp_s = T_PLC_ZERO_S + noted[k][0] + truth.clock_offset_s
                u0, v0, u1, v1, u2, v2, u3, v3 = found.ravel().tolist()
                yield MarkerCorners(stamp_s, eye, marker.marker_id, u0, v0, u1, v1, u2, v2, u3, v3)
