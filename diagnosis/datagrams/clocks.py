"""The PC's and the camera's clocks against the PLC's, also where their offset is not given.

Numbers of datagrams give it but for the link's delay; how pictures move gives the rest (`cells/camera_clock.py`).
"""

import numpy as np

from diagnosis.datagrams.sent import sent_clock
from diagnosis.log.tables import Tables


def is_offset_guessed(tables: Tables) -> bool:
    """Whether the offset between PLC and PC is not given, and numbers of datagrams give it but for a constant."""
    return tables.run_info.plc_to_pc_offset_s is None and sent_clock(tables, []) is not None


def plc_to_pc_s(tables: Tables) -> float:
    """t_pc = t_plc + this, as well as is known; 0 where nothing shows it."""
    given = tables.run_info.plc_to_pc_offset_s
    if given is not None:
        return given
    clock = sent_clock(tables, [])
    return clock.offset_s if clock is not None and np.isfinite(clock.offset_s) else 0.0


def camera_to_plc_s(tables: Tables) -> float:
    """t_plc = t_camera + this, as well as is known; 0 where nothing shows it."""
    return (tables.run_info.camera_to_pc_offset_s or 0.0) - plc_to_pc_s(tables)
