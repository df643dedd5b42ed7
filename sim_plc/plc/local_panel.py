"""The controls at the machine itself: enable key, local lever, emergency stop. No network command reaches them."""

from dataclasses import dataclass
from typing import Literal

EnableMode = Literal["auto", "panel"]


@dataclass(slots=True)
class LocalPanel:
    """`enable_mode` "auto": the enable is given again by itself after every disarming (for unattended machines).

    "panel": a person must give it, and after the last disarming: an enable left on does not arm the machine again.
    """

    enable_mode: EnableMode = "auto"
    enabled: bool = False
    lever_taken: bool = False
    estop_pressed: bool = False
    _fresh: bool = False

    def press_enable(self) -> None:
        """Give the enable: a rising edge."""
        self.enabled = self._fresh = True

    def release_enable(self) -> None:
        """Take the enable away; while armed the PLC makes a fault of it."""
        self.enabled = self._fresh = False

    def disarmed(self) -> None:
        """The PLC has left the armed states: a new rising edge is needed from now on."""
        self._fresh = False

    @property
    def may_arm(self) -> bool:
        """Whether the enable was given since the last disarming."""
        return self.enable_mode == "auto" or (self.enabled and self._fresh)

    @property
    def is_enable_withdrawn(self) -> bool:
        """Whether an armed machine must stop because its enable is gone."""
        return self.enable_mode == "panel" and not self.enabled
