"""The kinematic chain as plain arrays, ready for the compiled kernels."""

from dataclasses import dataclass

import numpy as np

from machine.description import Machine
from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class Chain:
    """Classic DH rows as arrays (n,), joint limits (n,) [rad], and link 7 `T_flange_tcp` (4, 4)."""

    a: Array
    d: Array
    alpha: Array
    theta_offset: Array
    q_min: Array
    q_max: Array
    T_flange_tcp: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.a)


def chain_of(machine: Machine) -> Chain:
    """The chain of a machine."""

    def column(name: str) -> Array:
        values = np.array([getattr(joint, name) for joint in machine.joints], dtype=float)
        values.setflags(write=False)
        return values

    return Chain(
        a=column("a_m"),
        d=column("d_m"),
        alpha=column("alpha_rad"),
        theta_offset=column("theta_offset_rad"),
        q_min=column("q_min_rad"),
        q_max=column("q_max_rad"),
        T_flange_tcp=machine.T_flange_tcp,
    )
