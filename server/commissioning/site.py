"""The site: the machine under commissioning with its link, its camera and its engineer, as the steps see them."""

from dataclasses import dataclass
from pathlib import Path

from machine.chain import Chain
from machine.description import Machine
from server.camera.client import VisionClient
from server.commissioning.contracts import Operator
from server.link.client import LinkClient
from server.settings import ServerSettings


@dataclass(frozen=True, slots=True)
class CommissioningOptions:
    """What the engineer chose."""

    listen_s: float = 10.0  # how long the link is watched at rest
    zero_tolerance_deg: float = 1.0  # between an encoder and what is read at the machine
    ask_for_ends: bool = False  # drive every joint to its mechanical ends by lever
    each_joint: bool = False  # stop times of every joint by itself too
    arm_timeout_s: float = 5.0  # longer where a person must press the enable first
    settings_file: Path | None = None  # of the server: what is found may be written there


@dataclass(slots=True)
class Site:
    """Everything a step may use. `vision` is None when no requested step looks."""

    settings: ServerSettings
    machine: Machine
    chain: Chain
    link: LinkClient
    vision: VisionClient | None
    operator: Operator
    options: CommissioningOptions
    move_permission: bool | None = None  # to move; None: not asked yet

    async def may_move(self) -> bool:
        """Whether the engineer has given leave to move; asked the first time only."""
        if self.move_permission is None:
            self.move_permission = await self.operator.may_move(self.machine.name)
        return self.move_permission
