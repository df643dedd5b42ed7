"""Both ends of the PLC link without a socket: say hello, arm, and see the PLC hold."""

import itertools

import longreach
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.limits import axis_mask, cfg_id, limits_of
from protocol.messages import PlcStatus
from protocol.plc_states import PlcEvent

MS = 1_000_000  # ns
table = limits_of(longreach.read_machine("hiab033").joints)
nonces = itertools.count(1001)
plc = longreach.PlcLink(longreach.PlcLinkSettings(cfg_id(table), simulation=True), RawFraming(), lambda: next(nonces))
pc = longreach.ClientLink(table, RawFraming(), session=1)

plc.apply(PlcEvent.BOOTED, 0)
pc.request_arm()
t_ns = 0
while plc.state is not PlcState.HOLD and t_ns < 1000 * MS:
    t_ns += MS  # one PLC cycle a step; the PC sends every 20 ms, the PLC every 10 ms
    plc.poll(t_ns)
    if t_ns % (20 * MS) == 0:
        pc.poll(t_ns)
        command = pc.send(t_ns)
        if command is not None:
            plc.receive(command, t_ns, "pc")
    if t_ns % (10 * MS) == 0 and plc.receivers():
        pc.receive(plc.send(PlcStatus(axis_mask=axis_mask(table)), t_ns), t_ns)
print(f"after {t_ns // MS} ms the PLC is in {plc.state.name}, the PC sees {pc.phase(t_ns).name}")
