"""Machines, drives and a slow reference for the tests of effects."""

import math
from pathlib import Path

import numpy as np

from machine.description import Machine, parse_machine_toml
from machine.effects.dynamics import Actuators, Drive, actuators_of, drive_by_sent
from machine.effects.layout import ParameterSets, neutral_sets, slots_of
from machine.effects.registry import EFFECTS
from machine.effects.spec import Effect

ROOT = Path(__file__).parents[3]
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])


def hiab() -> Machine:
    return parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


def plant_of_hiab(log_cycle_s: float = 0.01, delay_s: float = 0.0) -> Actuators:
    plant = actuators_of(hiab())
    return Actuators(plant.joints, plant.cycle_s, log_cycle_s, delay_s)


def reference(t_s: np.ndarray) -> np.ndarray:
    """A reference with fast and slow parts, reversals and a rest, (m, 6) [rad]."""
    rates = np.array([2.1, 1.3, 1.7, 2.9, 2.3, 3.1])
    wave = np.array([1.0, 3.0, 1.0, 1.0, 1.0, 1.0]) * 0.08 * np.sin(t_s[:, None] * rates) + 0.02 * np.sin(
        5.3 * t_s[:, None] * rates
    )
    return Q_START + wave * (t_s[:, None] > 0.1)


def drive(plant: Actuators, duration_s: float = 3.0, loads: bool = False) -> Drive:
    t = np.arange(0.0, duration_s, 0.004)
    cycles = round(duration_s / plant.cycle_s)
    rows = (cycles - 1) // plant.cycles_per_row + 1
    load = np.full((rows, plant.n), -0.6) * np.linspace(0.5, 1.0, rows)[:, None]
    both = (load, np.full((rows, plant.n), -0.001)) if loads else None
    return drive_by_sent(plant, t, reference(t), 0.0, cycles, both)


def is_dynamic(effect: Effect) -> bool:
    """Whether the kernel holds it."""
    own = ("link", "controller", "actuator", "joint")
    return effect.stage in own or effect.name in ("link_flexibility", "payload_error")


def random_sets(n: int, sets: int, seed: int, share: float = 1.0) -> ParameterSets:
    """Every dynamic effect at once, drawn evenly inside its bounds (times share); limits between their bounds."""
    rng = np.random.default_rng(seed)
    drawn = neutral_sets(n, sets)
    for effect in (one for one in EFFECTS if is_dynamic(one)):
        for joint in [None] if effect.scope == "machine" else range(1, n + 1):
            for slot in slots_of(effect.name, joint):
                values = rng.uniform(slot.lower_bound, slot.typical_max, sets)
                near = (
                    slot.neutral_value + share * (values - slot.neutral_value)
                    if math.isfinite(slot.neutral_value)
                    else values
                )
                inside = np.clip(near, slot.lower_bound, slot.typical_max)
                drawn.put(slot, np.round(inside) if slot.parameter == "order" else inside)
    return drawn
