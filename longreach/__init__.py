"""The command `longreach`, and the names of its Python API, each loaded when it is first used.

    import longreach

    machine = longreach.read_machine("hiab033")
    T_base_tcp = longreach.tcp_pose(longreach.chain_of(machine), q_rad)

`examples/` shows each of them in a short script; docs/python-api.md lists them.
"""

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diagnosis.budget import Budget
    from diagnosis.diagnose import diagnose
    from longreach.fleet_client import JobClient
    from machine.chain import Chain, chain_of
    from machine.description import Machine
    from machine.inverse import inverse_nearest
    from machine.kinematics import tcp_jacobian, tcp_pose
    from protocol.client_link import ClientLink
    from protocol.plc_link import PlcLink, PlcLinkSettings
    from recording.content import Recording
    from recording.opening import read_run as read_recording
    from server.settings import read_machine
    from server.vision.aruco_source import ArucoPoseSource

# fmt: off
_PLACES = {
    "ArucoPoseSource": "server.vision.aruco_source", "Budget": "diagnosis.budget", "Chain": "machine.chain",
    "ClientLink": "protocol.client_link", "JobClient": "longreach.fleet_client", "Machine": "machine.description",
    "PlcLink": "protocol.plc_link", "PlcLinkSettings": "protocol.plc_link", "Recording": "recording.content",
    "chain_of": "machine.chain", "diagnose": "diagnosis.diagnose", "inverse_nearest": "machine.inverse",
    "read_machine": "server.settings", "read_recording": "recording.opening:read_run",
    "tcp_jacobian": "machine.kinematics", "tcp_pose": "machine.kinematics",
}

__all__ = [
    "ArucoPoseSource", "Budget", "Chain", "ClientLink", "JobClient", "Machine", "PlcLink", "PlcLinkSettings",
    "Recording", "chain_of", "diagnose", "inverse_nearest", "read_machine", "read_recording", "tcp_jacobian",
    "tcp_pose",
]
# fmt: on


@cache
def _prepare_cache() -> None:
    """As the command does at its start: compiled code has a place also where nothing of ours can be written."""
    import_module("longreach.cli").prepare_cache()


def __getattr__(name: str) -> Any:
    """A name of the API, from the package that holds it (PEP 562)."""
    if name not in _PLACES:
        raise AttributeError(f"module 'longreach' has no attribute '{name}'; docs/python-api.md lists its names")
    _prepare_cache()
    module, _, other = _PLACES[name].partition(":")
    return getattr(import_module(module), other or name)
