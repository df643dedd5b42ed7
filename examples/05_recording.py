"""Write a recording as a folder of CSV files, and read it back: rows of one kind as columns."""

import math
import tempfile
from importlib.resources import files
from pathlib import Path

import numpy as np

import longreach
from recording.content import column
from recording.folder import write_folder
from recording.rows import PlcState
from recording.run import RunInfo, Segment

ZEROS, NONE = (0.0,) * 6, (float("nan"),) * 6
machine_toml = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")


def state(n: int) -> PlcState:
    """One PLC cycle: joint 1 follows its reference 0.1 s late."""
    t_s = 0.01 * n
    q_ref, q = (0.1 * math.sin(t_s), *ZEROS[1:]), (0.1 * math.sin(t_s - 0.1), *ZEROS[1:])
    return PlcState(t_s, n, q_ref, ZEROS, q, ZEROS, NONE, NONE, p_supply_pa=2e7, t_oil_c=45.0)


rows = tuple(state(n) for n in range(200))
run = RunInfo("an example", segments=(Segment("sine", "multisine", 0.0, 1.99),))

with tempfile.TemporaryDirectory() as place:
    write_folder(longreach.Recording("folder", run, machine_toml, rows), Path(place) / "run")
    whole = longreach.read_recording(Path(place) / "run")  # an MCAP file is read by the same call
    states = whole.of(PlcState)
    lag = column(states, "q_ref_rad")[:, 0] - column(states, "q_rad")[:, 0]
    lag_deg = np.rad2deg(np.abs(lag).max())
    print(f"{whole.run_info.name}: {len(states)} PLC states, joint 1 lags by up to {lag_deg:.2f} deg")
