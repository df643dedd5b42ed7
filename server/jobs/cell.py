"""The cell: one machine with its link, its camera and its recorder, as the jobs and the API see them."""

from dataclasses import dataclass, field

from machine.chain import Chain
from machine.description import Machine
from server.camera.client import VisionClient
from server.jobs.knowledge import Knowledge
from server.link.client import LinkClient
from server.recorder import Recorder
from server.settings import ServerSettings


@dataclass(slots=True)
class Cell:
    """Everything that belongs to one machine while the server runs."""

    settings: ServerSettings
    machine: Machine
    chain: Chain
    machine_text: str
    link: LinkClient
    vision: VisionClient
    recorder: Recorder
    knowledge: Knowledge = field(default_factory=Knowledge)
    startup_note: str = ""  # what the server still prepares, and so no job may begin; empty when it is done
    not_commissioned: str = "no commissioning report was read"  # why it may not jog where it is REAL; empty: it may
