"""Forward and inverse kinematics: from joints to the pose of the TCP, and back."""

import numpy as np

import longreach

chain = longreach.chain_of(longreach.read_machine("hiab033"))
q_rad = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])

T_base_tcp = longreach.tcp_pose(chain, q_rad)  # 4 x 4: p_base = T_base_tcp @ p_tcp
print("TCP in base axes [m]:", np.round(T_base_tcp[:3, 3], 3))

T_base_tcp[2, 3] += 0.05  # 50 mm higher
found = longreach.inverse_nearest(chain, T_base_tcp, q_rad)
if found.q_rad is None:
    raise SystemExit(found.reason)
print("joints change by [deg]:", np.round(np.rad2deg(found.q_rad - q_rad), 2))

speed = longreach.tcp_jacobian(chain, q_rad) @ np.deg2rad([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
print(f"slewing at 1 deg/s moves the TCP at {1e3 * np.linalg.norm(speed[:3]):.0f} mm/s")
