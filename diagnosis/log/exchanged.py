"""Signals of one joint that stand in each other's columns, found by what the machine file says of its controller."""

import numpy as np
from scipy.signal import lfilter

from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import PlcTable, fill_gaps
from machine.effects.kernel import KP, TAU
from machine.rotations import Array

FITS, FITS_NOT = 0.5, 1.5  # of the command's own size: what the controller leaves of it; 2 with the sign reversed
COMMAND_STD_MIN = 1e-3  # size of a command that says anything
LOG_ROWS_MIN = 100


def exchanged_loops(plc: PlcTable, nominal: Nominal) -> list[Finding]:
    """Joints whose reference stands in the encoder's column and the other way round.

    Model: u = PT1(kp (q_ref - q)) by the machine file; exchanged, the same of the other sign.
    """
    if not nominal.has_controller or nominal.actuators is None or plc.enc is None or plc.ref is None or plc.u is None:
        return []
    steps = np.diff(plc.t_s)
    if plc.enc.shape[1] != nominal.actuators.n or len(steps) < LOG_ROWS_MIN or not (steps > 0.0).any():
        return []
    dt_s, wrong = float(np.median(steps[steps > 0.0])), list[int]()
    for j, joint in enumerate(nominal.actuators.joints):
        share = 1.0 - np.exp(-dt_s / max(float(joint[TAU]), 1e-9))
        u = fill_gaps(plc.u)[:, j]
        wanted = joint[KP] * (fill_gaps(plc.ref)[:, j] - fill_gaps(plc.enc)[:, j])
        by_controller: Array = np.asarray(lfilter([share], [1.0, share - 1.0], wanted), dtype=float)
        size = float(np.std(u))
        as_written, exchanged = (float(np.std(u - sign * by_controller)) for sign in (1.0, -1.0))
        if size > COMMAND_STD_MIN and exchanged < FITS * size and as_written > FITS_NOT * size:
            wrong.append(j + 1)
    if not wrong:
        return []
    names = ", ".join(f"q_{j}_rad and q_ref_{j}_rad" for j in wrong)
    text = f"{names} are exchanged: the valves work as the controller of the machine file would the other way round"
    return [Finding("swapped_columns", "fatal", "plc.csv", text, len(wrong))]
