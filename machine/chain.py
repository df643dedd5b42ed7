"""The kinematic chain as plain arrays, ready for the compiled kernels."""

from dataclasses import dataclass, fields

import numpy as np

from machine.description import Machine
from machine.errors import MachineError
from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class Chain:
    """Classic DH rows as arrays (n,), joint limits (n,) [rad], and link 7 `T_flange_tcp` (4, 4); read-only copies."""

    dh_a_m: Array
    dh_d_m: Array
    dh_alpha_rad: Array
    theta_offset: Array
    q_min: Array
    q_max: Array
    T_flange_tcp: Array
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Copy the arrays in, read-only, and refuse wrong shapes and values."""
        n = np.size(self.dh_a_m)
        for field in fields(self):
            if field.name == "names":
                continue
            wanted = (4, 4) if field.name == "T_flange_tcp" else (n,)
            array = np.array(getattr(self, field.name), dtype=float, order="C")
            if array.shape != wanted or not np.isfinite(array).all():
                raise MachineError(f"chain: {field.name} has shape {array.shape}; give finite values of shape {wanted}")
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.dh_a_m)

    def joint_label(self, index: int) -> str:
        """How a joint is called in messages, from its index (0 = slew): "joint 2 (lift)"."""
        return f"joint {index + 1} ({self.names[index]})" if self.names else f"joint {index + 1}"


def chain_of(machine: Machine) -> Chain:
    """The chain of a machine."""
    joints = machine.joints
    return Chain(
        dh_a_m=np.array([joint.a_m for joint in joints]),
        dh_d_m=np.array([joint.d_m for joint in joints]),
        dh_alpha_rad=np.array([joint.alpha_rad for joint in joints]),
        theta_offset=np.array([joint.theta_offset_rad for joint in joints]),
        q_min=np.array([joint.q_min_rad for joint in joints]),
        q_max=np.array([joint.q_max_rad for joint in joints]),
        T_flange_tcp=machine.T_flange_tcp,
        names=tuple(joint.name for joint in joints),
    )
