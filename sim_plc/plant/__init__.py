"""The fine plant of the simulated machine: multibody, structure, hydraulics, friction and play at 1 kHz."""
