"""The commands on their way: which datagrams came, when each took effect, and what the clocks are off by."""
