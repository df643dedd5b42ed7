"""Numbers of the foreign plant: the PATU 655 log crane as others published it, and what we had to assume beside it.

Sources (facts only):
  [P] github.com/qkhadim22/PatuCrane_Exudyn, Models/RigidSystem.py
  [I] github.com/qkhadim22/Exudyn-hydraulically-actuated-industrial-systems, Models/Container.py
  [A] assumed by us
Published coordinates have x forward, y up, z to the right of the crane, in metres.
"""

import numpy as np

GRAVITY = 9.81

# Pillar; the lift boom turns on it.
PILLAR_KG, PILLAR_COM = 93.26, (-0.017403, 0.577291, 0.0)  # [P]
PILLAR_I = (16.36, 0.61, 16.53)  # about its centre of mass, along the axes [P]
LIFT_PIVOT = (-0.09, 1.4261)  # on the pillar [P]

# Lift boom, from its pivot.
LIFT_KG, LIFT_COM, LIFT_I = 143.66, (1.229248, 0.055596, 0.0), (1.06, 66.58, 67.05)  # [P]
TILT_PIVOT = (2.881080943, 0.021592554)  # [P]
LIFT_FOOT, LIFT_HEAD = (0.17, 0.386113249), (0.3025, -0.105)  # cylinder: on the pillar, on the boom [P]
TILT_FOOT = (1.263, 0.206702194)  # of the tilt cylinder, on the lift boom [P]

# Tilt boom with its extension pulled in, from its pivot.
TILT_KG, TILT_COM = 141.942729 + 15.928340, (0.659935, 0.251085, 0.0)  # [P]
TILT_I = (1.06, 66.58, 67.05)  # [P]: printed there the same as the lift boom's
TILT_LUG = (-0.095, 0.24043237)  # of the linkage [P]
BOOM_END = 2.40  # of the tilt boom's 2.58 m [P] from its pivot to the tool [A]
BOOM_HIGH = 0.251085  # of the boom's middle line over its pivot: its centre of mass [P]

# Four-bar linkage between lift boom, tilt cylinder and tilt boom.
BRACKET_PIVOT = (2.69, -0.006592554)  # of bracket 1 on the lift boom [P]
BRACKET_TIP = (-0.457227402, 0.0425)  # of bracket 1: cylinder head and bracket 2 [P]
BRACKET_KG, BRACKET_COM, BRACKET_I = 11.524039, (-0.257068, 0.004, 0.0), (0.08, 0.33, 0.27)  # [P]
ROD_M, ROD_KG = 0.475, 7.900191  # bracket 2, a rod [P]; its mass goes to both ends in halves [A]

TOOL_KG = 60.0  # camera and tool head at the boom's end [A]

# Cylinders: piston and rod side [m2], shortest length, stroke [m].
AREA_A = 0.25 * np.pi * 0.100**2  # [P]
AREA_B = AREA_A - 0.25 * np.pi * 0.056**2  # [P]
LIFT_CYLINDER = (0.820, 0.535)  # [P]
TILT_CYLINDER = (1.050, 0.780)  # [P]
PITCH_RADIUS, RACK_KG = 0.15, 20.0  # slew by a rack on the pillar: no such drive is published [A]
RACK_CYLINDER = (0.70, 0.60)  # [A]

# Oil and valves.
HOSE_M3 = 0.25 * np.pi * 0.0127**2 * 1.5  # each line: 12.7 mm, 1.5 m [P]
OIL_PA, CYLINDER_PA, HOSE_PA = 1650e6, 2.1e11, 700e6  # bulk moduli [P]
P_SUPPLY, P_TANK = 160e5, 1e5  # [I]
VALVE_FLOW = 40e-3 / 60.0 / np.sqrt(35e5)  # of an edge: 40 l/min at 3.5 MPa [I]; per root pascal
VALVE_HZ, VALVE_DAMPING = 20.0, 0.8  # proportional valve [A]
RIPPLE_PA, RIPPLE_HZ = 1.5e5, 37.0  # of the supply [A]

# Friction of a cylinder: Coulomb, static [N], Stribeck speed [m/s], viscous [N s/m]; lift's dry part counts four times.
COULOMB, STATIC, STRIBECK, VISCOUS = 210.0, 300.0, 5e-3, 330.0  # [P]
DRY = (2.0, 4.0, 1.0)  # slew [A], lift, tilt [P]

# Structure between encoder and tool: torsion springs [N m/rad] and dampers [N m s/rad] at pillar, lift boom, tilt boom.
SPRINGS = (1.2e6, 3.4e6, 1.5e6)  # lift: 3 EI / L by its free modes at 107 Hz [P]; others [A]
DAMPERS = (3700.0, 7100.0, 2200.0)  # 4 % of critical with the arm at work [A]
# The part of each body before its spring [A].
ROOT_KG, ROOT_COM = (20.0, 25.0, 20.0), ((0.0, 0.0, 0.3), (0.2, -0.05, 0.0), (0.0, 0.15, 0.0))
ROOT_I = ((1.0, 1.0, 0.2), (0.3, 1.0, 1.0), (0.3, 1.0, 1.0))

# The electronics behind each valve: a flow set point from the spool's opening, held by measured pressures (all [A]).
FLOW_ERROR = (0.03, -0.02)  # what the calibration of the valve left when its piston goes out, comes in
COMPENSATED, COMPENSATOR_S = 0.8, 0.25  # share of the load that is compensated, and how slowly
DEAD_BAND, HYSTERESIS = 0.015, 0.003  # left of the spool, fractions of full command
PLAY_RAD = (1.2e-3, 0.0, 0.0)  # of the slewing rack, peak to peak

# The nominal machine.
HOME_RAD = np.deg2rad([0.0, 30.0, -70.0])
RANGES_DEG = ((-60.0, 60.0), (-20.0, 75.0), (-140.0, -2.0))  # slew [A]; lift and tilt by the strokes [P]
SPEED_FULL = (0.50, 0.44, 0.50)  # joint speed at full command [rad/s]: what the valves give [I]
KP, PT1_S = (2.5, 4.0, 4.0), (0.0, 0.10, 0.10)  # controller: command per rad, lag [A]
QD_MAX_DEG, QDD_MAX_DEG = (20.0, 15.0, 20.0), (40.0, 30.0, 40.0)  # [A]
COUNTS = 262144  # [A]
