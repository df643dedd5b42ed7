"""What a machine file's effects change between the reference and the valve: for a plant that has no oil of its own.

An independent implementation, not the kernel that the diagnosis fits with: another order of steps, 1 ms each.
"""

from dataclasses import dataclass, replace

import numpy as np

from machine.description import Machine
from machine.effects.entries import EffectEntry
from machine.rotations import Array
from sim_plc.plc.settings import PlcSettings, plc_settings

VALVE = ("valve_deadband", "valve_hysteresis", "valve_lag", "valve_asymmetry")
CONTROLLER = ("controller_gain_error", "controller_lag_error", "controller_saturation")
LINK = ("transport_delay",)
NAMES = (*VALVE, *CONTROLLER, *LINK)


@dataclass(frozen=True, slots=True)
class SideNumbers:
    """Numbers of n joints (n,): half widths and limits in fractions of full command; `delay_s` of the reference."""

    dead: Array
    full_flow: Array  # share of the flow that a full command still gives
    hysteresis: Array
    lag_share: Array  # of the way that a first-order lag goes in a cycle; 1: no lag
    forward_gain: Array
    limit: Array
    delay_s: float


def side_numbers(entries: tuple[EffectEntry, ...], n: int, cycle_s: float) -> SideNumbers:
    """The numbers of those effects that belong here; the others are passed over."""
    dead, lost, hysteresis, lag = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    gain, limit, delay = np.ones(n), np.ones(n), 0.0
    for effect in entries:
        j = (effect.joint or 1) - 1
        match effect.name:
            case "valve_deadband":
                dead[j] += effect.value("half_width_frac")
                lost[j] += effect.value("half_width_frac") if effect.option == "lost" else 0.0
            case "valve_hysteresis":
                hysteresis[j] += effect.value("half_width_frac")
            case "valve_lag":
                lag[j] += effect.value("time_constant_s")
            case "valve_asymmetry":
                gain[j] *= 1.0 + effect.value("gain_frac")
            case "controller_saturation":
                limit[j] = min(limit[j], effect.value("limit_frac"))
            case "transport_delay":
                delay += effect.value("delay_s")
            case _:
                pass
    share = np.where(lag > 0.0, 1.0 - np.exp(-cycle_s / np.maximum(lag, 1e-9)), 1.0)
    full_flow = (1.0 - dead) / (1.0 - dead + lost)
    return SideNumbers(dead, full_flow, hysteresis, share, gain, limit, delay)


def controller_settings(machine: Machine, entries: tuple[EffectEntry, ...], cycle_s: float = 0.0) -> PlcSettings:
    """The PLC's gains with the controller's effects: kp (1 + g), tau (1 + x).

    `cycle_s`: how often the controller runs here, if not as often as the machine's PLC.
    """
    plain = plc_settings(machine)
    kp, tau = np.array(plain.kp_frac_per_rad), np.array([joint.pt1_tau_s for joint in machine.joints])
    for effect in entries:
        if effect.name == "controller_gain_error":
            kp[(effect.joint or 1) - 1] *= 1.0 + effect.value("gain_frac")
        elif effect.name == "controller_lag_error":
            tau[(effect.joint or 1) - 1] *= 1.0 + effect.value("lag_frac")
    share = np.where(tau > 0.0, 1.0 - np.exp(-(cycle_s or plain.cycle_s) / np.maximum(tau, 1e-9)), 1.0)
    return replace(plain, kp_frac_per_rad=kp, pt1_share=share)
