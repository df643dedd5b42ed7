"""Simulate many parameter sets through the dynamic stages, from the sent reference or from each stage's own input."""

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from machine.description import Machine
from machine.effects import kernel
from machine.effects.layout import N_JOINT_PARAMETERS, N_MACHINE_PARAMETERS, ParameterSets
from machine.errors import MachineError
from machine.rotations import Array

TIE_S, ROUNDINGS = 1e-9, 4.0  # of a stamp: seconds since 1970 are known to a quarter of a microsecond
INTEGRATION_STEP_MAX_S = 1e-3  # of the integration (the nominal model's definition)
INTEGRATION_PHASE_MAX_RAD = 0.8  # valve's angular frequency times step: stable to 1.2 at any damping below 1


class DynamicStage(IntEnum):
    """Stages of the kernel, in the order of the chain."""

    LINK = kernel.LINK
    CONTROLLER = kernel.CONTROLLER
    ACTUATOR = kernel.ACTUATOR
    JOINT = kernel.JOINT


@dataclass(frozen=True, slots=True)
class Actuators:
    """Nominal joints: columns velocity gain [rad/s], valve frequency [rad/s], damping, kp [1/rad], PT-1 [s]; times."""

    joints: Array
    cycle_s: float
    log_cycle_s: float
    transport_delay_s: float
    step_refinement_factor: int = 1  # times as many steps as the nominal model's definition asks for

    def __post_init__(self) -> None:
        """Refuse wrong shapes, values, and a log cycle that is not a multiple of the PLC's cycle."""
        joints = np.array(self.joints, dtype=float, order="C")
        if joints.ndim != 2 or joints.shape[1] != 5 or not np.isfinite(joints).all() or (joints[:, :3] <= 0).any():
            raise MachineError(
                f"actuators have shape {joints.shape}; give finite (n, 5), velocity gain and valve above 0"
            )
        joints.setflags(write=False)
        object.__setattr__(self, "joints", joints)
        if not 0.0 <= self.transport_delay_s < math.inf:  # the kernel looks so many cycles back
            raise MachineError(f"plc.transport_delay_s = {self.transport_delay_s} s; give 0 or more")
        if not (self.cycle_s > 0.0 and abs(self.log_cycle_s / self.cycle_s - self.cycles_per_row) < 1e-6):
            raise MachineError(
                f"plc.log_cycle_s = {self.log_cycle_s} s is not a multiple of cycle_s = {self.cycle_s} s; give one"
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.joints.shape[0]

    @property
    def cycles_per_row(self) -> int:
        """PLC cycles per logged row."""
        return max(1, round(self.log_cycle_s / self.cycle_s))

    @property
    def whole_delay_s(self) -> float:
        """The nominal transport delay's whole PLC cycles [s]; the rest says for which cycle a reference waits."""
        return math.floor(self.transport_delay_s / self.cycle_s + 1e-6) * self.cycle_s

    @property
    def substeps(self) -> int:
        """Integration steps per PLC cycle."""
        wn, damping = self.joints[:, kernel.WN], self.joints[:, kernel.ZETA]
        fastest = np.where(
            damping > 1.0, 2.0 * damping * wn, wn / INTEGRATION_PHASE_MAX_RAD
        ).max()  # [1/s], a step's share of it
        steps = int(np.ceil(max(self.cycle_s / INTEGRATION_STEP_MAX_S, self.cycle_s * float(fastest)) - 1e-9))
        return self.step_refinement_factor * steps


def actuators_of(machine: Machine) -> Actuators:
    """The nominal actuators of a machine."""
    rows = [
        (j.velocity_gain_rad_s, 2.0 * np.pi * j.valve_frequency_hz, j.valve_damping, j.kp_frac_per_rad, j.pt1_tau_s)
        for j in machine.joints
    ]
    return Actuators(np.array(rows), machine.plc_cycle_s, machine.plc_log_cycle_s, machine.transport_delay_s)


@dataclass(frozen=True, slots=True)
class Drive:
    """What a run is driven by. Rows of `ref`, `enc`, `u`, `latest_sent_indices` are PLC cycles; loads per logged row.

    `load`: gravity torque over the joint's reference torque, along the motion; `load_kg`: its change per kg at the tcp.
    `last_arrived_indices`: for each reference the last one that is known to have arrived; empty where losses are not
    known one by one.
    """

    first_stage: DynamicStage
    n_cycles: int
    sent: Array
    latest_sent_indices: NDArray[np.int64]
    ref: Array
    enc: Array
    u: Array
    load: Array
    load_kg: Array
    enc_start: Array
    u_start: Array
    last_arrived_indices: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True, slots=True)
class SimulatedTraces:
    """Logged rows of each set, (sets, rows, n): received reference, valve command, encoder, link side."""

    ref: Array
    u: Array
    enc: Array
    link: Array


def drive_by_sent(
    plant: Actuators,
    t_sent_s: Array,
    sent: Array,
    t_start_s: float,
    cycles: int,
    loads: tuple[Array, Array] | None = None,
    lost: NDArray[np.bool_] | None = None,
) -> Drive:
    """From the reference as sent.

    Args:    t_sent_s: (m,) [s], rising, on the PLC's clock. sent: (m, n) [rad]. t_start_s: of the first PLC cycle.
             loads: (load, load_kg), each (rows, n); zero without. lost: (m,), those that any packet_loss takes away;
             without it they are drawn.
    Model:   the PLC holds the last reference that arrived, latest[k] = last i with t_sent[i] + part <= t_k, where part
             is the nominal delay's part of a cycle. What transport_delay adds shifts by PLC cycles, a part of a cycle
             by interpolation between two neighbours.
    """
    times = np.asarray(t_sent_s, dtype=float) + (plant.transport_delay_s - plant.whole_delay_s)
    values = _checked_table(sent, plant.n, "sent reference")
    rising = len(times) > 0 and np.isfinite(times).all() and not (np.diff(times) < 0).any()
    if times.shape != (len(values),) or not rising:
        raise MachineError(f"sent times have shape {times.shape} for {len(values)} references; give one each, rising")
    if cycles < 1 or (lost is not None and lost.shape != times.shape):
        lost_shape = "none" if lost is None else lost.shape
        raise MachineError(
            f"{cycles} PLC cycles, lost of shape {lost_shape}; give one cycle or more, and one word each"
        )
    t_cycles = t_start_s + plant.cycle_s * np.arange(cycles)
    tie_s = TIE_S + ROUNDINGS * float(np.spacing(np.abs(times).max()))
    latest = np.maximum(np.searchsorted(times, t_cycles + tie_s, side="right") - 1, 0).astype(np.int64)
    none = np.zeros((0, plant.n))
    start = values[latest[0]].copy()
    zero = np.zeros(plant.n)
    kept = np.zeros(0, np.int64) if lost is None else _last_there(~lost)
    both = _checked_loads(plant, cycles, loads)
    return Drive(DynamicStage.LINK, cycles, values, latest, none, none, none, *both, start, zero, kept)


def _last_there(there: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each row the last one at or before it that is there; the first where there is none."""
    return np.maximum.accumulate(np.where(there, np.arange(len(there)), 0)).astype(np.int64)


def drive_controller(plant: Actuators, ref: Array, enc: Array, u_start: Array, fine: bool = False) -> Drive:
    """From received reference and encoders, logged rows (rows, n) [rad]; `u_start`: first valve command (n,).

    `fine`: the rows are PLC cycles already.
    """
    ref_cycles, enc_cycles = _rows_at_cycles(plant, ref, fine), _rows_at_cycles(plant, enc, fine)
    if ref_cycles.shape != enc_cycles.shape:
        raise MachineError(f"references {np.shape(ref)} and encoders {np.shape(enc)} differ in shape; give equal rows")
    cycles = len(ref_cycles)
    none, nothing = np.zeros((0, plant.n)), np.zeros(0, np.int64)
    loads = _checked_loads(plant, cycles, None)
    first = enc_cycles[0].copy()
    start = _of_joints(plant, u_start, "first valve command")
    return Drive(DynamicStage.CONTROLLER, cycles, none, nothing, ref_cycles, enc_cycles, none, *loads, first, start)


def drive_actuator(
    plant: Actuators, u: Array, enc_start: Array, loads: tuple[Array, Array] | None = None, fine: bool = False
) -> Drive:
    """From the valve commands, logged rows (rows, n), and where the encoders stood (n,) [rad].

    `fine`: the rows are PLC cycles already; loads stay logged rows.
    """
    u_cycles = _rows_at_cycles(plant, u, fine)
    none, nothing = np.zeros((0, plant.n)), np.zeros(0, np.int64)
    both = _checked_loads(plant, len(u_cycles), loads)
    start = _of_joints(plant, enc_start, "encoders at the start")
    first = u_cycles[0].copy()
    return Drive(DynamicStage.ACTUATOR, len(u_cycles), none, nothing, none, none, u_cycles, *both, start, first)


def _of_joints(plant: Actuators, values: Array, what: str) -> Array:
    out = np.array(values, dtype=float)
    if out.shape != (plant.n,):
        raise MachineError(f"{what} has shape {out.shape}; the plant has {plant.n} joints")
    return out


def drive_joint(plant: Actuators, enc: Array) -> Drive:
    """From the encoders, logged rows (rows, n) [rad]."""
    cycles = at_cycles(plant, enc)
    none, nothing = np.zeros((0, plant.n)), np.zeros(0, np.int64)
    loads = _checked_loads(plant, len(cycles), None)
    start, zero = cycles[0].copy(), np.zeros(plant.n)
    return Drive(DynamicStage.JOINT, len(cycles), none, nothing, none, cycles, none, *loads, start, zero)


def simulate(
    plant: Actuators, sets: ParameterSets, drive: Drive, last: DynamicStage = DynamicStage.JOINT
) -> SimulatedTraces:
    """Every set from the drive's stage to `last`.

    Returns: logged rows (sets, rows, n), row r at PLC cycle r * decimate. Stages that did not run repeat their input.
    Raises:  MachineError: shapes do not fit.
    """
    n = plant.n
    if sets.joint_parameters.shape[1:] != (n, N_JOINT_PARAMETERS) or sets.machine_parameters.shape != (
        sets.set_count,
        N_MACHINE_PARAMETERS,
    ):
        raise MachineError(
            f"parameters have shapes {sets.joint_parameters.shape}, {sets.machine_parameters.shape}; the plant has {n} "
            "joints"
        )
    if last < drive.first_stage:
        raise MachineError(f"a run cannot begin at stage {drive.first_stage.name} and end at {last.name}; swap them")
    if drive.first_stage is DynamicStage.LINK and last is DynamicStage.CONTROLLER:
        raise MachineError("a controller behind the link needs the encoders; begin at CONTROLLER, or end at ACTUATOR")
    rows = (drive.n_cycles - 1) // plant.cycles_per_row + 1
    traces = SimulatedTraces(*(np.empty((sets.set_count, rows, n)) for _ in range(4)))
    kernel.run_stages(
        int(drive.first_stage),
        int(last),
        sets.joint_parameters,
        sets.machine_parameters,
        plant.joints,
        plant.cycle_s,
        plant.substeps,
        plant.cycles_per_row,
        plant.whole_delay_s,
        drive.sent,
        drive.latest_sent_indices,
        drive.last_arrived_indices,
        drive.ref,
        drive.enc,
        drive.u,
        drive.load,
        drive.load_kg,
        drive.enc_start,
        drive.u_start,
        traces.ref,
        traces.u,
        traces.enc,
        traces.link,
    )
    return traces


def _rows_at_cycles(plant: Actuators, rows: Array, fine: bool) -> Array:
    return _checked_table(rows, plant.n, "PLC cycles") if fine else at_cycles(plant, rows)


def at_cycles(plant: Actuators, logged: Array) -> Array:
    """Logged rows (rows, n) at every PLC cycle, linear in between; ((rows - 1) decimate + 1, n)."""
    values = _checked_table(logged, plant.n, "logged rows")
    if plant.cycles_per_row == 1:
        return values
    part = (np.arange(plant.cycles_per_row) / plant.cycles_per_row)[:, None]
    between = values[:-1, None] + part * np.diff(values, axis=0)[:, None]  # (rows - 1, cycles of a row, n)
    return np.concatenate([between.reshape(-1, plant.n), values[-1:]])


def _checked_table(values: Array, n: int, subject: str) -> Array:
    table = np.array(values, dtype=float, order="C")
    if table.ndim != 2 or table.shape[1] != n or len(table) == 0 or not np.isfinite(table).all():
        raise MachineError(f"{subject} have shape {table.shape}; give finite (rows, {n}), at least one row")
    return table


def _checked_loads(plant: Actuators, cycles: int, loads: tuple[Array, Array] | None) -> tuple[Array, Array]:
    rows = (cycles - 1) // plant.cycles_per_row + 1
    if loads is None:
        return np.zeros((rows, plant.n)), np.zeros((rows, plant.n))
    load, load_kg = (_checked_table(values, plant.n, "loads") for values in loads)
    if load.shape != (rows, plant.n) or load_kg.shape != load.shape:
        raise MachineError(f"loads have shapes {load.shape}, {load_kg.shape}; the run has {rows} logged rows")
    return load, load_kg
