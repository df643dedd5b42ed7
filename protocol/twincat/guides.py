"""Guides of the exported PLC program: start, import, commissioning; each lists what is not verified."""

from protocol import layout, timeouts
from protocol.limits import AxisLimits, cfg_id
from protocol.twincat.documents import PROTOCOL_VERSION_TEXT
from protocol.twincat.parameters import PlcParameters

_IN_TIME_MS = (timeouts.COMMAND_LOST_TIMEOUT.duration_ns + timeouts.STATE_PERIOD.duration_ns) // timeouts.MS
_NOT_VERIFIED = """\
## What is not verified

Nothing here has run on a real TwinCAT runtime or a real machine. Verified: tests execute the Structured Text in
parallel with the simulated PLC, and it sends the same bytes; an independent parser reads every file; Wireshark's own
dissector decodes the EAP frames. To be confirmed on the machine:

- that XAE imports the files as they are and compiles them, that it opens HmPlc.sln (never tried: two other readers list
  every file of it), and that every SIZEOF is as here (`bLayoutOk`);
- the EAP state-machine byte (we send 0 and ignore it), the meaning of VarState's bits, whether TwinCAT checks the
  frame's length;
- FB_HmUdpTf6310 and FB_HmUdpTf6311, which have been parsed but never run; the size limit of TF6311 (1304 bytes are
  within one Ethernet frame);
- the longest cycle time: FB_HmMotion states the work of its worst cycle.
"""
_WATCH_LIST = """\
## Watch list

| Variable | Should be |
|---|---|
| `MAIN.fbPlc.bLayoutOk` | TRUE |
| `MAIN.fbPlc.ePlcState` | DISARMED, then LINKED with a PC, HOLD when armed, RUN in motion |
| `GVL_HmIo.nCmdVarState`, `nCmdCycleIndex`, `nCmdQuality` | 0; running; below 1000 (100 ms) |
| `MAIN.uTx.m.rx_ok`, `rx_lost`, `rx_bad` | rising by 50 a second; still; still |
| `MAIN.uTx.m.rx_age_us` | below 40000 |
| `MAIN.uTx.m.reject_code`, `reject_offset` | 0; else docs/reject-codes.md and docs/offsets.md |
| `MAIN.uTx.m.fault_bits`, `warn_bits` | 0 |
| `MAIN.uTx.m.buffer_us` | above 250000 in the middle of a motion |
| `MAIN.uTx.m.q_ref`, `MAIN.uTx.m.q` | equal while disarmed; the joints behind the reference in motion |
| `MAIN.fbPlc.aValves` | 0 in dry run |
"""


def start_page(p: PlcParameters) -> str:
    """The first page of the exported PLC files: steps from unpacking to the first dry run."""
    return f"""\
# {p.machine_name}: the PLC end of HMLINK {PROTOCOL_VERSION_TEXT}

One command datagram 50 times a second from the PC, one state datagram every 10 ms from the PLC. The PC sends knots of
a reference ahead of time; the PLC plays them on its own clock, checks them against its own limits, and ramps down by
itself when the PC falls silent. **This link is not a safety channel**: emergency stop and enable stay hard-wired.

| | |
|---|---|
| layout_id | {layout.LAYOUT_ID:#010x} |
| cfg_id | {cfg_id(p.limit_table):#010x} |
| axes | {", ".join(axis.name for axis in p.limit_table.axes)} |
| task cycle | {p.cycle_ns / 1e6:g} ms |
| PLC | {p.plc_address}, AMS NetId {p.plc_net_id} |
| PC | {p.pc_address}, AMS NetId {p.pc_net_id} |

## From here to the first dry run

1. **Import**: open `twincat/HmPlc.sln`, or take `twincat/` into a PLC project of your own, as docs/import.md says.
2. **Task**: PlcTask calls MAIN every {p.cycle_ns / 1e6:g} ms. For another cycle change the machine file and
   export again.
3. **Layout**: build, run, look at `MAIN.fbPlc.bLayoutOk`. FALSE latches fault LAYOUT: a struct has another layout than
   here, or limits were edited without a new export. `MAIN.fbPlc.fbSelfCheck` shows which check fails. If none fails and
   `nOddCycles` is 100, the task's cycle is not that of step 2.
4. **EAP**: eap/configuration-sheet.md. VarState must be 0 and CycleIndex must run as soon as the PC sends.
5. **Dry run**: `GVL_HmIo.bDryRun` is TRUE from the start: everything is played, the valves stay closed. Leave it so.
6. **PC**: `longreach commission --framing eap --plc-host {p.plc_address}`. Its first step arms, plays a small
   trajectory in dry run, then falls silent on purpose: the PLC must leave RUN within {_IN_TIME_MS} ms and go to HOLD.
7. **Watch** the list below. When the dry run is right, go on with docs/commissioning.md.

{_WATCH_LIST}
## What is in the folder

- `twincat/`: data types and constants (generated), blocks and MAIN (written by hand), task, project and solution;
- `eap/configuration-sheet.md`: what to type into XAE;
- `wireshark/hmlink.lua`: shows every field, in raw datagrams and inside EAP frames;
- `c/hmlink.h`: the messages for C and C++;
- `vectors/`: a golden conversation as captures (EAP and raw), as text and as JSON;
- `docs/`: import, commissioning, offsets, time limits with reasons, states, reject codes;
- `MANIFEST.txt`: SHA-256 of every file; `sha256sum -c MANIFEST.txt` lists what was edited since.

{_NOT_VERIFIED}"""


def import_page() -> str:
    """How to import the files into a PLC project."""
    return """\
# Import into TwinCAT

`twincat/HmPlc.sln` opens in TwinCAT XAE (3.1, build 4024 or newer) as a whole: one PLC project with every file of
twincat/, the task PlcTask at this machine's cycle calling MAIN, and the references Tc2_Standard and Tc2_System.

1. Open twincat/HmPlc.sln. Choose the target system.
2. FB_HmUdpTf6310 and FB_HmUdpTf6311 are listed and excluded from the build: they need TF6310 (Tc2_TcpIp) and TF6311
   with their libraries. To use one, add its library and clear Exclude from build in its properties.
3. Real-Time: give PlcTask a core of its own where there is one.

Into a project of your own instead (also without the three project files, should your XAE refuse them):

4. Right-click DUTs, GVLs, POUs > Add > Existing Item: all files in twincat/DUTs, twincat/GVLs, twincat/POUs. Leave MAIN
   out where you have one, and call FB_HmPlc from yours as our MAIN does. Leave out the two blocks of step 2.
5. References: Tc2_Standard, Tc2_System.
6. PlcTask calls MAIN; set its cycle as in README.md.

Then, either way:

7. Bind GVL_HmIo: the EAP variables as in eap/configuration-sheet.md; bEnable, bLeverTaken and bEstop to their switches;
   until MAIN sets bPanelValid from the state of their terminal nothing arms. In MAIN, where it says "here", scale this
   machine's encoders and pressures into stSample, and aValves to its valves.
8. Build. Read the warnings, and report errors to us: none of this has been compiled by a real XAE yet.

The files have fixed ids, so an import of a newer export replaces the older one. Edit nothing in DUTs and GVLs but
GVL_HmIo and GVL_HmAuth: change the machine file and export again, else fault LAYOUT or reject CFG reports it.
"""


def commissioning_page(p: PlcParameters) -> str:
    """Commissioning from the dry run to the moving machine, with the expected observation of each step."""
    rows = "\n".join(_joint_row(axis) for axis in p.limit_table.axes)
    ramp_s = max(axis.qd_max / axis.qdd_max for axis in p.limit_table.axes)
    return f"""\
# Commissioning {p.machine_name}

The valves stay closed until step 5. One person at the machine with the emergency stop in hand, one at the PLC.
`longreach commission` leads through the same list from the PC, measures, and writes the report.

1. **Emergency stop and enable**: hard-wired, tried with the pump off. `GVL_HmIo.bEstop` and `bEnable` follow their
   switches, `bLeverTaken` the lever. Unplug their terminal: `bPanelValid` goes FALSE, and a key that is left on does
   not arm when it comes back.
2. **Limits**: cfg_id of the state is {cfg_id(p.limit_table):#010x}, the PC's the same; else the PC is refused with CFG.
3. **Dry run** (`bDryRun` TRUE): connect, turn the enable key, arm, play a small trajectory: `q_ref` moves, `aValves`
   stays 0. Pull the network cable in mid-motion: STOPPING within {_IN_TIME_MS} ms, HOLD after a ramp of about
   {ramp_s:.1f} s or less, DISARMED after 1 s of silence. Plug it in: nothing moves; HELLO and ARM are needed again.
4. **Encoders**, pump on, by lever (LOCAL): sign, zero and range of every joint as in the table. Unplug one encoder:
   MAIN must report it as a NaN (`uSample.w[j] := 16#7FF8_0000_0000_0000`), and fault SENSOR must appear
   (while armed, a jumping reading raises it as well).
5. **Valves, joint by joint** (`bDryRun` FALSE while disarmed: armed, the dry run lasts until the next disarming;
   low pump pressure if you can, boom low): jog 2 degrees there and back.
   The valve must open to the side that moves the encoder towards the reference; a wrong sign shows as fault LAG.
6. **Gains**: P on every joint; PT-1 (pt1_tau_s above 0) on those that carry the weight. GVL_HmMachine comes from the
   machine file: change it there and export again.
7. **Stop times**: STOP, QUICK_STOP and silence, at half and at full speed, joint by joint; the ramp must end within the
   last column of the table, plus {_IN_TIME_MS} ms for silence.
8. **Limits again**: command past each range and speed: each must be refused, with its code and its field.

| Joint | q_min rad | q_max rad | qd_max rad/s | qdd_max rad/s^2 | longest ramp s |
|---|---|---|---|---|---|
{rows}

{_WATCH_LIST}
{_NOT_VERIFIED}"""


def _joint_row(axis: AxisLimits) -> str:
    numbers = (axis.q_min, axis.q_max, axis.qd_max, axis.qdd_max)
    return f"| {axis.name} | {' | '.join(f'{x:.4f}' for x in numbers)} | {axis.qd_max / axis.qdd_max:.2f} |"
