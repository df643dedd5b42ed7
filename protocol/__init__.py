"""HMLINK 1: the datagrams between PC and PLC, and the rules of both ends. Sans-IO: bytes and time come as arguments.

The wire format, the states and every timeout are described for a PLC engineer in docs/plc-link.md.

Public API (import from the modules; nothing here opens a socket, sleeps, reads a clock or draws a random number)

    protocol.codes        Mode, PlcState, LinkState, RejectCode, FaultBit, WarnBit, AxisBit, Interp, CommandFlag,
                          HeaderFlag, reject_text(code) -> str
    protocol.layout       N_AXIS_SLOTS = 8, KNOTS_PER_COMMAND = 6, COMMAND_SIZE = 1304, STATE_SIZE = 568, LAYOUT_ID,
                          SCHEMA_TEXT, HEADER_LAYOUT, COMMAND_BODY_LAYOUT, KNOT_LAYOUT, COMMAND_TAIL_LAYOUT,
                          STATE_BODY_LAYOUT (fields with offsets)
    protocol.messages     Knot(t_ns, q, qd, qdd), Command(...), PlcStatus(...), State(...): frozen, tuples of 8
                          floats, SI; pad_to_eight_axes(values) fills up with zeros
    protocol.codec        encode_command(Command) -> bytes, decode_command(bytes) -> Command, encode_state, decode_state
    protocol.framing      RawFraming(), EapFraming.for_client(pc_net_id, plc_net_id), EapFraming.for_plc(...):
                          wrap(payload, seq) -> datagram, unwrap(datagram) -> payload
    protocol.limits       AxisLimits, LimitTable, limits_of(machine.joints) -> table, cfg_id(table), axis_mask(table)
    protocol.timeouts     every time limit of the link in one table, each with its reason
    protocol.sequence     classify_sequence(last, seq) -> SequenceVerdict(kind, n_lost)
    protocol.plc_states   PlcEvent, next_state(state, event) -> PlcState, TRANSITIONS, mermaid_diagram() -> str
    protocol.gate         gate(command, view, table) -> GateVerdict, check_trajectory(knots, q_ref, table) -> refusals
    protocol.client_state ClockOffset: PLC to PC clock offset by the echo's four stamps
    protocol.playback     Playback: the sliding window over a trajectory
    protocol.client_link  ClientLink: the PC's end; protocol.client_events: its events
    protocol.plc_link     PlcLink, PlcLinkSettings: the PLC's end (receive rules, states; knows nothing of joints)
    protocol.plc_events   CommandAccepted, PlcAction, CommandRejected, StateChanged, SessionOpened, SessionVoid: what
    PlcLink hands up protocol.errors       ProtocolError > LocalProtocolError (our mistake) | RemoteProtocolError (their
    bytes; .code)

How a PLC uses its end (one cycle; t_plc_ns = the PLC's own monotonic clock, starting above 0):

    link = PlcLink(PlcLinkSettings(cfg_id=cfg_id(table)), framing, draw_nonce, check)
    link.apply(PlcEvent.BOOTED, t_plc_ns)                  # BOOT -> DISARMED
    every cycle:
        for datagram, source in arrived:
            for event in link.receive(datagram, t_plc_ns, source): handle(event)
        for event in link.poll(t_plc_ns): handle(event)    # silence: RUN -> STOPPING (250 ms), session void (1 s)
        ... cycle logic looks at link.state, and passes to the link what only it knows:
        link.apply(PlcEvent.END | AT_REST | SOFT_STOP (underrun) | FAULT | LOCAL_ON | LOCAL_OFF, t_plc_ns)
        every 10 ms, for each of link.receivers():         # the peer, and once a sender that was refused
            the same link.send(PlcStatus(...), t_plc_ns)

    `check(command, state) -> RejectCode` is the PLC logic's own last word on a command before it counts as accepted:
    limits, knot continuity, ring space; for mode ARM local enable, lag and faults; for RESET whether the cause is gone.
    NONE accepts. It must not change anything: a command may only be used when it comes back as an event.

    CommandAccepted(command, action): action is KEEPALIVE, ARM, LOAD (put the knots into the ring), STOP, QUICK_STOP,
    RESET or DISARM. StateChanged comes before the CommandAccepted that caused it: the first LOAD with the start flag
    follows StateChanged(HOLD, RUN, START). Without the flag LOAD prefills the ring in HOLD. LOAD is never handed up for
    a trajectory that has ended or was stopped. A LOAD whose traj_id is new replaces the ring. Knots below knot_playing
    come again (the window is a round trip behind): ignore them.

What the PLC logic reports in PlcStatus about playback (the client paces on it):
    traj_id       the trajectory in the ring; stays after its end until the next one is loaded
    knot_playing  index of the knot that begins the segment being played; n - 1 when the end is reached
    knot_last     highest index up to which the ring is gapless (a gap is refilled because this does not advance)
    t_play_ns     playback time in the trajectory; the last knot's t_ns at its end
    buffer_us     trajectory time still in the ring ahead of t_play_ns
"""
