"""What is diagnosed here: long recordings of the reduced model with two faults, and short ones for a fleet."""

from dataclasses import dataclass
from pathlib import Path

from benchmarks.diagnosis.links.cases import entry
from benchmarks.diagnosis.links.recorded import Course, Link, over
from machine.effects.entries import EffectEntry
from recording.folder import write_folder

LONG = ("repeat", "repeat", "repeat", "repeat", "steps", "steps", "workcycle", "workcycle")
LONG_S = 60.0
SHORT = ("repeat", "repeat", "repeat", "steps")
SHORT_S = 6.0
AS_LOGGED = Link()  # at once, rows of 10 ms
FAULTS = (("valve_deadband", {"half_width_frac": 0.02}), ("flow_gain_error", {"gain_frac": 0.05}))


@dataclass(frozen=True, slots=True)
class Size:
    """A recording by its joints; the two faults are on the last one and the one before, or both on the only one."""

    joints: int

    @property
    def effects(self) -> tuple[EffectEntry, ...]:
        """What is wrong in it."""
        places = (self.joints, max(1, self.joints - 1))
        return tuple(entry(name, joint, values) for (name, values), joint in zip(FAULTS, places, strict=True))

    def write(self, folder: Path, seed: int) -> None:
        """Eight segments of a minute, as CSV files."""
        write_folder(over(AS_LOGGED, self.effects, seed, Course(LONG, LONG_S, self.joints)), folder)


def write_short(folder: Path, seed: int) -> None:
    """One joint for half a minute; of three, one is healthy, one has a fault, one has both."""
    effects = Size(1).effects[: seed % (1 + len(FAULTS))]
    write_folder(over(AS_LOGGED, effects, seed, Course(SHORT, SHORT_S, 1)), folder)
