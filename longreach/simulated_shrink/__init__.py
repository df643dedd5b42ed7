"""How far the gap shrinks in the simulator itself: its plant driven by a recording, without and with the effects."""
