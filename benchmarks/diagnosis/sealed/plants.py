"""The plants of the benchmark behind one interface: what a generator, a scorer and its tables need of a machine."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.diagnosis.sealed import behind, own_plant
from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import Faults
from machine.description import Joint
from machine.rotations import Array
from sim_plc.plant.tree import FLEX_JOINT_INDICES, MOTOR_JOINT_INDICES

NAMES = ("own", "foreign")


class Arm(Protocol):
    """The true arm behind the joints, at tree angles (k,): motors and springs in the plant's own order."""

    def points(self, tree_q: Array) -> dict[str, Array]:
        """Tracked points in base (3,) [m]."""
        ...

    def tcp(self, tree_q: Array) -> Array:
        """T_base_tcp (4, 4)."""
        ...


class Plant(Protocol):
    """A simulated machine with three joints, this benchmark's PLC cycle, link and camera."""

    @property
    def home_rad(self) -> Array:
        """Where every segment begins and ends (3,)."""
        ...

    @property
    def motors(self) -> Sequence[int]:
        """Columns of `Course.tree_q` that the encoders read."""
        ...

    @property
    def springs(self) -> Sequence[int]:
        """Columns that bend behind them."""
        ...

    @property
    def play_rad(self) -> Array:
        """Play of the undisturbed machine (3,), peak to peak."""
        ...

    @property
    def joints(self) -> Sequence[Joint]:
        """The nominal joints."""
        ...

    def toml(self) -> str:
        """The nominal machine file."""
        ...

    def T_base_ooi(self) -> Array:
        """Where the seen object stands (4, 4)."""
        ...

    def run(
        self, faults: Faults, ref: Array, shock: Array, u_given: Array | None = None, near: Array | None = None
    ) -> own_plant.Course:
        """Drive it from home along the received reference (m, 3) [rad], in open loop kept `near` where it can be."""
        ...

    def arm(self, faults: Faults) -> Arm:
        """The arm with the injected effects of the structure."""
        ...

    def rest_poses(self, faults: Faults, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Encoder readings (m, 3) and tree angles (m, k) of poses at rest; every third is visited twice."""
        ...


@dataclass(frozen=True)
class OwnArm:
    """The fine plant's tree."""

    structure: behind.Structure

    def points(self, tree_q: Array) -> dict[str, Array]:
        """Tracked points in base (3,) [m]."""
        return behind.points_at(self.structure, tree_q)

    def tcp(self, tree_q: Array) -> Array:
        """T_base_tcp (4, 4)."""
        return behind.link_frames(self.structure, *behind.bodies_at(self.structure, tree_q))[0]


@dataclass(frozen=True)
class OwnPlant:
    """The fine plant of sim_plc."""

    home_rad = own.HOME_RAD
    motors = tuple(int(i) for i in MOTOR_JOINT_INDICES[: own.N])
    springs = tuple(int(i) for i in FLEX_JOINT_INDICES)

    @property
    def play_rad(self) -> Array:
        """Play of the undisturbed machine (3,), peak to peak."""
        return own_plant.truth().kinematics.backlash_rad[: own.N]

    @property
    def joints(self) -> Sequence[Joint]:
        """The nominal joints."""
        return own.six_joints().joints[: own.N]

    def toml(self) -> str:
        """The nominal machine file."""
        return own.toml()

    def T_base_ooi(self) -> Array:
        """Where the seen object stands (4, 4)."""
        return own.T_base_ooi()

    def run(
        self, faults: Faults, ref: Array, shock: Array, u_given: Array | None = None, near: Array | None = None
    ) -> own_plant.Course:
        """Drive it from home along the received reference (m, 3) [rad], in open loop kept `near` where it can be."""
        return own_plant.run(faults, ref, shock, u_given, near)

    def arm(self, faults: Faults) -> OwnArm:
        """The arm with the injected effects of the structure."""
        return OwnArm(behind.structure_of(faults))

    def rest_poses(self, faults: Faults, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Encoder readings (m, 3) and tree angles (m, 11) of poses at rest; every third is visited twice."""
        return behind.rest_poses(faults, rng, count)


OWN = OwnPlant()


def plant_named(name: str) -> Plant:
    """The plant of a name.

    Raises: KeyError: no such plant. ImportError: the foreign one without Exudyn (`pip install -e '.[bench]'`).
    """
    if name == "own":
        return OWN
    if name == "foreign":
        from benchmarks.diagnosis.sealed.foreign_plant import ForeignPlant  # Exudyn is optional

        return ForeignPlant()
    raise KeyError(f"no plant {name}; there are {', '.join(NAMES)}")
