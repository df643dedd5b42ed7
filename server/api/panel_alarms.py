"""The alarm list: latched until acknowledged, gone when acknowledged and no longer so. Pure; time is an argument."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from protocol.codes import FaultBit
from server.api.panel_alarm_catalogue import CATALOGUE
from server.api.views import StateView
from server.disk_space import disk_shortage

LOSS_MAX_PCT = 5.0
IMAGE_UNFIT_ALARM_DELAY_S = 0.5
STARTUP_ALARM_DELAY_S = 90.0  # silence is not an alarm while everything starts; on a new machine the start compiles
STORE_FAILED_ALARM_CODE = "store_failed"
FAULT_CODES: tuple[tuple[FaultBit, str], ...] = (
    (FaultBit.ESTOP, "plc_estop"),
    (FaultBit.LOCAL_ENABLE_LOST, "plc_enable_lost"),
    (FaultBit.LAG, "plc_lag"),
    (FaultBit.JOINT_RANGE, "plc_joint_range"),
    (FaultBit.SENSOR, "plc_sensor"),
    (FaultBit.PRESSURE, "plc_pressure"),
    (FaultBit.OIL_TEMPERATURE, "plc_oil_temperature"),
    (FaultBit.CYCLE_OVERRUN | FaultBit.LAYOUT, "plc_program"),
)
PLC_FAULT_ALARM_CODES = frozenset(code for _, code in FAULT_CODES)


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm in the list. `ended_unix_s` None: its cause is still there."""

    code: str
    detail: str
    since_unix_s: float
    ended_unix_s: float | None = None
    acknowledged_by: str = ""


class AlarmBook:
    """What is wrong and what was."""

    def __init__(self) -> None:
        self._alarms: dict[str, Alarm] = {}

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """Unacknowledged first, of them what is still so, then by priority, the newest first."""
        order = {"high": 0, "medium": 1, "low": 2}
        return tuple(
            sorted(
                self._alarms.values(),
                key=lambda one: (
                    bool(one.acknowledged_by),
                    one.ended_unix_s is not None,
                    order[CATALOGUE[one.code].level],
                    -one.since_unix_s,
                ),
            )
        )

    @property
    def active(self) -> frozenset[str]:
        """Codes of the alarms whose cause is there."""
        return frozenset(code for code, alarm in self._alarms.items() if alarm.ended_unix_s is None)

    def update(self, active: Mapping[str, str], t_unix_s: float, unknown: frozenset[str] = frozenset()) -> None:
        """`active`: the alarms whose cause is there now, with their details; `unknown`: those whose cause cannot be
        checked now, they stay as they are.
        """
        for code, detail in active.items():
            known = self._alarms.get(code)
            if known is None or known.ended_unix_s is not None:  # it came back: a new one, to be acknowledged again
                self._alarms[code] = Alarm(code, detail, t_unix_s)
            else:
                self._alarms[code] = replace(known, detail=detail)
        for code, known in list(self._alarms.items()):
            if code in active or code in unknown:
                continue
            if known.acknowledged_by:
                del self._alarms[code]
            elif known.ended_unix_s is None:
                self._alarms[code] = replace(known, ended_unix_s=t_unix_s)

    def raise_event(self, code: str, detail: str, t_unix_s: float) -> None:
        """Something that happened once: its cause is over, the alarm stays until acknowledged."""
        self._alarms[code] = Alarm(code, detail, t_unix_s, ended_unix_s=t_unix_s)

    def acknowledge(self, code: str, who: str) -> bool:
        """Seen by a person; False when there is no such alarm."""
        known = self._alarms.get(code)
        if known is None:
            return False
        if known.ended_unix_s is not None:
            del self._alarms[code]
        else:
            self._alarms[code] = replace(known, acknowledged_by=who)
        return True


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is not in the state view: disk, recorder, 3D view, recent loss, the server itself."""

    disk_free_bytes: int | None
    recorder_problem: str
    scene_problem: str
    vision_problem: str
    loss_pct: float
    unfit_for_s: float
    up_s: float  # since the server started
    set_mode: str = "SIM"  # as the settings have it
    store_problem: str = ""
    other_pc: str = ""  # as the link reports it
    inner_faults: Mapping[str, str] = field(default_factory=dict)  # of the server's own parts, by alarm code


def active_alarms(state: StateView, around: Surroundings) -> dict[str, str]:
    """Alarms whose cause is there now: code -> what to show in addition to the catalogue's text."""
    return (
        _plc_alarms(state, around)
        | ({"plc_contested": around.other_pc} if around.other_pc else {})
        | _camera_alarms(state, around)
        | ({"link_lossy": f"{around.loss_pct:.1f} % lost"} if around.loss_pct > LOSS_MAX_PCT else {})
        | ({"recording_failed": around.recorder_problem} if around.recorder_problem else {})
        | ({"disk_low": low} if (low := disk_shortage(around.disk_free_bytes)) else {})
        | ({"scene_ended": around.scene_problem} if around.scene_problem else {})
        | _calibration_alarms(state)
        | _mode_mismatch_alarms(state, around)
        | dict(around.inner_faults)
        | ({STORE_FAILED_ALARM_CODE: around.store_problem} if around.store_problem else {})
    )


def unknown_alarms(state: StateView) -> frozenset[str]:
    """Alarms whose cause cannot be checked now: a silent PLC reports none of its faults."""
    return frozenset(code for _, code in FAULT_CODES) if state.link.phase == "offline" else frozenset()


def _plc_alarms(state: StateView, around: Surroundings) -> dict[str, str]:
    link = state.link
    if link.phase == "offline":
        if link.age_ms is None and around.up_s < STARTUP_ALARM_DELAY_S:
            return {}
        age = "no state received yet" if link.age_ms is None else f"last heard {link.age_ms / 1e3:.1f} s ago"
        return {"plc_silent": f"{age}. {link.warning}".strip()}
    bits = link.fault_bits
    return {code: f"reported by the PLC (fault bits {bits:#x})" for mask, code in FAULT_CODES if bits & mask}


def _camera_alarms(state: StateView, around: Surroundings) -> dict[str, str]:
    if around.vision_problem:
        return {"vision_ended": around.vision_problem}
    age_ms = state.camera.age_ms
    if age_ms is None and around.up_s < STARTUP_ALARM_DELAY_S:
        return {}
    if age_ms is None or age_ms > 1000.0:
        return {"camera_silent": state.camera.warnings[-1] if state.camera.warnings else "no image yet"}
    if state.camera.warnings and around.unfit_for_s > IMAGE_UNFIT_ALARM_DELAY_S:
        return {"camera_unfit": state.camera.warnings[-1]}
    return {}


def _mode_mismatch_alarms(state: StateView, around: Surroundings) -> dict[str, str]:
    if state.link.age_ms is None or state.link.simulation == (around.set_mode == "SIM"):
        return {}
    plc = "a simulation" if state.link.simulation else "a real machine"
    return {"mode_mismatch": f"the settings say {around.set_mode}, the PLC says that it drives {plc}"}


def _calibration_alarms(state: StateView) -> dict[str, str]:
    found = state.calibration
    return {} if found is None or found.valid else {"calibration_expired": found.expiry_reason}
