"""The export as a whole against the rest of the link: the machine it is for, the motion gate, the named fields."""

from dataclasses import replace

import pytest
from export_parts import PARAMETERS, exported

from longreach.export_command import st_sources
from protocol import layout
from protocol.codes import RejectCode
from protocol.gate import check_trajectory
from protocol.layout import command_field_at
from protocol.messages import Command, State
from protocol.twincat.bundle import build_bundle_files
from protocol.twincat.golden import golden_messages

GOLDENS = {golden.name: golden.message for golden in golden_messages(PARAMETERS)}


def command(name: str) -> Command:
    message = GOLDENS[name]
    assert isinstance(message, Command)
    return message


def state(name: str) -> State:
    message = GOLDENS[name]
    assert isinstance(message, State)
    return message


def test_another_machine_is_another_export() -> None:
    axes = (replace(PARAMETERS.limit_table.axes[0], qd_max=0.1), *PARAMETERS.limit_table.axes[1:])
    other = build_bundle_files(
        replace(PARAMETERS, limit_table=replace(PARAMETERS.limit_table, axes=axes)), st_sources()
    )
    changed = {path for path, data in exported().items() if data != other[path]}
    assert {"README.md", "twincat/GVLs/GVL_HmMachine.TcGVL", "vectors/eap.pcap", "MANIFEST.txt"} <= changed
    assert "twincat/POUs/FB_HmLink.TcPOU" not in changed


def test_the_gate_judges_the_golden_trajectories_as_they_claim() -> None:
    q_ref = state("state-hold").q_ref
    assert check_trajectory(command("trajectory").knots, q_ref, PARAMETERS.limit_table) == ()
    refused = check_trajectory(command("trajectory-refused").knots, q_ref, PARAMETERS.limit_table)
    assert RejectCode.IMPLIED_SPEED in {refusal.code for refusal in refused}
    assert command_field_at(state("state-refusal").reject_offset) == ("knot[1].q[0]", "LREAL", 288)


@pytest.mark.parametrize("offset", [48, 288, 0])
def test_refused_fields_are_named_with_their_value(offset: int) -> None:
    (golden,) = (golden for golden in golden_messages(PARAMETERS) if golden.name == "trajectory-refused")
    q = command("trajectory-refused").knots[1].q[0]
    expected = {48: "mode = 3", 288: f"knot[1].q[0] = {q:.6g}", 0: ""}[offset]
    assert layout.command_field_text(golden.payload, offset) == expected
    assert layout.command_field_text(golden.payload[:40], offset) == ""
