"""The state machine as an ST function, from the one transition table."""

from protocol.codes import PlcState
from protocol.plc_states import TRANSITIONS, PlcEvent

NAME = "F_HmNextState"


def next_state_source() -> str:
    """`F_HmNextState`: FALSE, and the state unchanged, for an event that has no place there."""
    cases = "\n".join(_state(state) for state in PlcState)
    return f"""\
(* The state after an event; generated from the transition table. FALSE: it has no place in this state. *)
FUNCTION {NAME} : BOOL
VAR_INPUT
    eState : E_HmPlcState;
    eEvent : E_HmEvent;
END_VAR
VAR_OUTPUT
    eNext : E_HmPlcState;
END_VAR
eNext := eState;
{NAME} := TRUE;
CASE eState OF
{cases}
ELSE
    {NAME} := FALSE;
END_CASE
END_FUNCTION
"""


def _state(state: PlcState) -> str:
    after: dict[PlcState, list[PlcEvent]] = {}
    for (before, event), new in TRANSITIONS.items():
        if before is state:
            after.setdefault(new, []).append(event)
    branches = []
    for new, events in after.items():
        labels = ", ".join(f"E_HmEvent.{event.name}" for event in events)
        branches.append(f"            {labels}:\n                eNext := E_HmPlcState.{new.name};")
    body = "\n".join(branches)
    other = f"        ELSE\n            {NAME} := FALSE;\n        END_CASE"
    return f"    E_HmPlcState.{state.name}:\n        CASE eEvent OF\n{body}\n{other}"
