"""Read a machine file: its joints, their limits, and its camera."""

import numpy as np

import longreach

machine = longreach.read_machine("hiab033")  # a shipped name, or the path of a machine file
for joint in machine.joints:
    low, high = np.rad2deg([joint.q_min_rad, joint.q_max_rad])
    print(f"{joint.name:12s} {low:7.1f} to {high:6.1f} deg, {np.rad2deg(joint.qd_max_rad_s):5.1f} deg/s")
print(f"camera: {machine.camera.width_px} x {machine.camera.height_px} px, {machine.camera.rate_hz:.0f} Hz")
