"""The simulated stereo camera: renders the wall, the OOI and the tool on the CPU and serves the pictures over HTTP."""
