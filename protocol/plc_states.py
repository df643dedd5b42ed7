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


_E = PlcEvent
_B, _D, _L, _H = PlcState.BOOT, PlcState.DISARMED, PlcState.LINKED, PlcState.HOLD
_R, _S, _F, _O = PlcState.RUN, PlcState.STOPPING, PlcState.FAULT, PlcState.LOCAL

# fmt: off
_TABLE = {
    _B: {_E.BOOTED: _D, _E.FAULT: _F},
    _D: {_E.HELLO: _L, _E.FAULT: _F, _E.LOCAL_ON: _O},
    _L: {
        _E.HELLO: _L, _E.ARM: _H, _E.SOFT_STOP: _L, _E.QUICK_STOP: _L, _E.DISARM: _D, _E.VOID: _D, _E.FAULT: _F,
        _E.LOCAL_ON: _O,
    },
    _H: {  # the PC repeats ARM until it sees HOLD
        _E.ARM: _H, _E.START: _R, _E.SOFT_STOP: _H, _E.QUICK_STOP: _H, _E.AT_REST: _H, _E.DISARM: _D, _E.VOID: _D,
        _E.FAULT: _F, _E.LOCAL_ON: _O,
    },
    _R: {  # DISARM: ramp first; the PC repeats DISARM, which then meets HOLD
        _E.END: _H, _E.SOFT_STOP: _S, _E.QUICK_STOP: _S, _E.DISARM: _S, _E.VOID: _S, _E.FAULT: _F, _E.LOCAL_ON: _O,
    },
    _S: {
        _E.AT_REST: _H, _E.SOFT_STOP: _S, _E.QUICK_STOP: _S, _E.DISARM: _S, _E.VOID: _S, _E.FAULT: _F, _E.LOCAL_ON: _O,
    },
    _F: {  # HELLO: a session may be opened to look and to reset
        _E.HELLO: _F, _E.SOFT_STOP: _F, _E.QUICK_STOP: _F, _E.DISARM: _F, _E.AT_REST: _F, _E.VOID: _F, _E.FAULT: _F,
        _E.RESET: _D,
    },
    _O: {
        _E.HELLO: _O, _E.SOFT_STOP: _O, _E.QUICK_STOP: _O, _E.DISARM: _O, _E.AT_REST: _O, _E.VOID: _O, _E.FAULT: _F,
        _E.LOCAL_OFF: _D,
    },
}
# fmt: on
TRANSITIONS = MappingProxyType({(state, event): after for state, row in _TABLE.items() for event, after in row.items()})

ARMED_STATES = frozenset({_H, _R, _S})


def next_state(state: PlcState, event: PlcEvent) -> PlcState:
    """The state after an event. Raises: IllegalTransitionError naming both; the caller's state is unchanged."""
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
