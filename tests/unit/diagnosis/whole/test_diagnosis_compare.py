"""Several machine files against one recording: the file that has the machine's effect misses the tool least."""

import numpy as np

from diagnosis.compare import tool_misses
from diagnosis.reading.read import read_for_diagnosis
from machine.description import parse_machine_toml
from machine.effects.entries import entries_to_toml, make_entry
from machine.effects.registry import effect_of
from recording.content import Recording
from recording.folder import write_folder
from recording.rows import NAN, PlcState
from recording.run import RunInfo, Segment
from server.settings import read_machine_text
from tests.unit.sim_plc.recorded_drive import follow_reference, offline, plain_world

TEXT = read_machine_text("hiab033")
HOME = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])
SECONDS, STEP_S = 24.0, 0.01


def test_the_file_with_the_effects_misses_least(tmp_path):
    found = tuple(
        make_entry(effect_of("valve_deadband"), joint, {"half_width_frac": 0.025, "full_flow": "kept"})
        for joint in (1, 2, 3)
    )
    machine = parse_machine_toml(TEXT)
    t_s = STEP_S * np.arange(round(SECONDS / STEP_S))
    fade = np.clip(np.minimum(t_s, SECONDS - t_s) / 3.0, 0.0, 1.0)[:, None]
    q_ref = HOME + 0.03 * fade * np.sin(2.0 * np.pi * t_s[:, None] / np.array([7.0, 5.0, 4.0, 6.0, 5.5, 4.5]))
    driven = follow_reference(offline(plain_world(machine), found), t_s, q_ref, HOME)
    none = (NAN,) * 6
    rows = [
        PlcState(100.0 + t, -1, tuple(ref), none, tuple(q), tuple(u), none, none, NAN, NAN)
        for t, ref, q, u in zip(t_s.tolist(), q_ref.tolist(), driven.q_encoder.tolist(), driven.u.tolist(), strict=True)
    ]
    run = RunInfo("drive", segments=(Segment("slow passes", "sweep", 100.0, 100.0 + float(t_s[-1])),))
    write_folder(Recording("folder", run, TEXT, tuple(rows)), tmp_path / "run")
    whole = read_for_diagnosis(tmp_path / "run")
    nominal, identified = tool_misses(whole, [("nominal", TEXT), ("identified", TEXT + "\n" + entries_to_toml(found))])
    assert (nominal.measured_by, identified.measured_by) == ("encoders", "encoders")
    assert nominal.rms_mm > 10.0
    assert identified.rms_mm < 0.1 * nominal.rms_mm
