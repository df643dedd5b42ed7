"""FB_HmMotion of the delivered program in the runner, as the pair wants it."""

from functools import cache

from st_harness import machine_with_cycle
from st_motion_pair import Outputs
from st_plc import CLOCK, RECEIVERS, delivered
from st_program import Program, load_program

_NUMBERS = ("eMotion", "nTrajId", "nKnotPlaying", "nKnotLast", "nBufferUs", "nPlayNs", "fRate", "fSpeedScale")
_ARRAYS = ("aQRef", "aQdRef", "aQddRef")


@cache
def program_of(cycle_s: float, count: bool = False, truncate: bool = False) -> Program:
    """The delivered program of the crane with this cycle, translated once."""
    sources = {**delivered(machine_with_cycle(cycle_s)), "GETCPUCOUNTER.st": CLOCK}
    return load_program(sources, RECEIVERS, count=count, truncate=truncate)


class DeliveredMotion:
    """One FB_HmMotion."""

    def __init__(self, program: Program) -> None:
        self._block = program.new("FB_HmMotion")
        self._command = program.new_union("U_HmCmd")

    def check(self, payload: bytes, servo: bool) -> tuple[int, int]:
        """Reject code and offset of CheckServo or CheckTrajectory."""
        self._command.bytes = payload
        code = self._block.method("CheckServo" if servo else "CheckTrajectory", self._command)
        return code, self._block.nRejectOffset

    def load(self, payload: bytes) -> None:
        """Load."""
        self._command.bytes = payload
        self._block.method("Load", self._command)

    def load_servo(self, payload: bytes, t_ns: int) -> None:
        """LoadServo."""
        self._command.bytes = payload
        self._block.method("LoadServo", self._command, nNowNs=t_ns)

    def stay(self, method: str, q: tuple[float, ...]) -> None:
        """HoldAt or Follow, at 8 values."""
        self._block.method(method, list(q))

    def do(self, method: str) -> None:
        """A method without arguments."""
        self._block.method(method)

    def starving(self) -> bool:
        """Starving."""
        return self._block.method("Starving")

    def step(self, t_ns: int) -> bool:
        """Step."""
        return self._block.method("Step", nNowNs=t_ns)

    def outputs(self) -> Outputs:
        """Publish, then every output by its name; eMotion as a number, joint arrays with 8 values."""
        self._block.method("Publish")
        numbers = {name: getattr(self._block, name) for name in _NUMBERS}
        return {**numbers, **{name: tuple(getattr(self._block, name)) for name in _ARRAYS}}
