"""The PLC's states as one table (state, event) -> state; diagram and documentation are generated from it.

Reasons are classified before they get here: underrun, a stop command and a silent PC are all SOFT_STOP,
everything that must latch is FAULT.
"""

from enum import Enum
from types import MappingProxyType

from protocol.codes import PlcState
from protocol.errors import IllegalTransitionError


class PlcEvent(Enum):
    """What can happen to the PLC's state."""

    BOOTED = "self-check passed"
    HELLO = "valid HELLO"
    ARM = "ARM with current nonce, enable, 25 good commands"
    START = "new trajectory with start flag"
    END = "last knot reached"
    SOFT_STOP = "stop, hold, silence, underrun, stale echo"
    QUICK_STOP = "quick stop"
    AT_REST = "reference at rest"
    DISARM = "DISARM"
    VOID = "silence > 1 s"
    FAULT = "fault"
    RESET = "RESET, cause gone"
    LOCAL_ON = "local lever taken"
    LOCAL_OFF = "local lever released"


_B, _D, _L, _H = PlcState.BOOT, PlcState.DISARMED, PlcState.LINKED, PlcState.HOLD
_R, _S, _F, _O = PlcState.RUN, PlcState.STOPPING, PlcState.FAULT, PlcState.LOCAL

TRANSITIONS = MappingProxyType(
    {
        (_B, PlcEvent.BOOTED): _D,
        (_B, PlcEvent.FAULT): _F,
        (_D, PlcEvent.HELLO): _L,
        (_D, PlcEvent.FAULT): _F,
        (_D, PlcEvent.LOCAL_ON): _O,
        (_L, PlcEvent.HELLO): _L,
        (_L, PlcEvent.ARM): _H,
        (_L, PlcEvent.SOFT_STOP): _L,
        (_L, PlcEvent.QUICK_STOP): _L,
        (_L, PlcEvent.DISARM): _D,
        (_L, PlcEvent.VOID): _D,
        (_L, PlcEvent.FAULT): _F,
        (_L, PlcEvent.LOCAL_ON): _O,
        (_H, PlcEvent.ARM): _H,  # the PC repeats ARM until it sees HOLD
        (_H, PlcEvent.START): _R,
        (_H, PlcEvent.SOFT_STOP): _H,
        (_H, PlcEvent.QUICK_STOP): _H,
        (_H, PlcEvent.AT_REST): _H,
        (_H, PlcEvent.DISARM): _D,
        (_H, PlcEvent.VOID): _D,
        (_H, PlcEvent.FAULT): _F,
        (_H, PlcEvent.LOCAL_ON): _O,
        (_R, PlcEvent.END): _H,
        (_R, PlcEvent.SOFT_STOP): _S,
        (_R, PlcEvent.QUICK_STOP): _S,
        (_R, PlcEvent.DISARM): _S,  # ramp first; the PC repeats DISARM, which then meets HOLD
        (_R, PlcEvent.VOID): _S,
        (_R, PlcEvent.FAULT): _F,
        (_R, PlcEvent.LOCAL_ON): _O,
        (_S, PlcEvent.AT_REST): _H,
        (_S, PlcEvent.SOFT_STOP): _S,
        (_S, PlcEvent.QUICK_STOP): _S,
        (_S, PlcEvent.DISARM): _S,
        (_S, PlcEvent.VOID): _S,
        (_S, PlcEvent.FAULT): _F,
        (_S, PlcEvent.LOCAL_ON): _O,
        (_F, PlcEvent.HELLO): _F,  # a session may be opened to look and to reset
        (_F, PlcEvent.SOFT_STOP): _F,
        (_F, PlcEvent.QUICK_STOP): _F,
        (_F, PlcEvent.DISARM): _F,
        (_F, PlcEvent.AT_REST): _F,
        (_F, PlcEvent.VOID): _F,
        (_F, PlcEvent.FAULT): _F,
        (_F, PlcEvent.RESET): _D,
        (_O, PlcEvent.HELLO): _O,
        (_O, PlcEvent.SOFT_STOP): _O,
        (_O, PlcEvent.QUICK_STOP): _O,
        (_O, PlcEvent.DISARM): _O,
        (_O, PlcEvent.AT_REST): _O,
        (_O, PlcEvent.VOID): _O,
        (_O, PlcEvent.FAULT): _F,
        (_O, PlcEvent.LOCAL_OFF): _D,
    }
)

ARMED_STATES = frozenset({_H, _R, _S})


def next_state(state: PlcState, event: PlcEvent) -> PlcState:
    """The state after an event.

    Raises: IllegalTransitionError naming both; the caller's state is unchanged.
    """
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise IllegalTransitionError(
            f"PLC state {state.name}: event {event.name} ({event.value}) has no place here"
        ) from None


def mermaid_diagram() -> str:
    """The table as a mermaid state diagram; events that change nothing are left out."""
    merged: dict[tuple[PlcState, PlcState], list[str]] = {}
    for (state, event), after in TRANSITIONS.items():
        if after is not state:
            merged.setdefault((state, after), []).append(event.name)
    lines = ["stateDiagram-v2", "    [*] --> BOOT"]
    lines += [f"    {a.name} --> {b.name}: {', '.join(names)}" for (a, b), names in merged.items()]
    return "\n".join(lines)
