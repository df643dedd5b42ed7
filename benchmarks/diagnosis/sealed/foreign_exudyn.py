"""The foreign plant's arm, cylinders and oil in Exudyn: its kinematic tree, its actuator, its implicit integrator.

Bodies, joints, springs, loop closure, chambers, orifices and friction are Exudyn's items; only the openings of the
valves' edges are ours (`foreign_valves`), set before every step.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

os.environ.setdefault("EXUDYN_MODULE", "fast")  # the same library without range checks: half the time
import exudyn as exu
from exudyn import itemInterface as items  # noqa: N813
from exudyn.advancedUtilities import CreateSymbolicUserFunction

from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_numbers as k
from benchmarks.diagnosis.sealed.foreign_valves import STEP_S
from machine.rotations import Array

TOLERANCE = 1e-4  # of Newton's residual; see the test of the step
RACK_AT = 1.0  # where the rack stands with slew at 0 [m]
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


class SolverError(Exception):
    """Exudyn's integrator gave up."""


@dataclass(frozen=True)
class Model:
    """An assembled system: its tree and its three actuators (slew, lift, tilt)."""

    system: Any
    tree: int
    actuators: tuple[int, ...]


def resting_pressures(force: float, area_a: float, area_b: float) -> tuple[float, float]:
    """Chamber pressures [Pa] behind a closed valve: midway between moving out and moving in at this force [N]."""
    cubes = area_a**3 + area_b**3
    out = (area_a * k.P_SUPPLY - area_b * k.P_TANK - force) / cubes * area_b**2 + k.P_TANK
    back = k.P_SUPPLY - (force + area_b * k.P_SUPPLY - area_a * k.P_TANK) / cubes * area_b**2
    p_b = 0.5 * (out + back)
    return (force + p_b * area_b) / area_a, p_b


def build(bodies: tuple[g.Body, ...], q: Array) -> Model:
    """The system at rest at tree angles (7,), its springs bent, its chambers carrying the weights."""
    mbs = exu.SystemContainer().AddSystem()
    node, tree = _tree(mbs, bodies, q)
    ground = mbs.AddObject(items.ObjectGround())

    def on(link: int, x: float, y: float, z: float = 0.0) -> int:
        place = [x, y, z]
        return mbs.AddMarker(items.MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=link, localPosition=place))

    rack = _rack(mbs, node)
    tip, lug = on(6, *k.BRACKET_TIP), on(4, *k.TILT_LUG)
    mbs.AddObject(items.ObjectConnectorDistance(markerNumbers=[tip, lug], distance=k.ROD_M))
    wall = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=ground, localPosition=[0.0, 0.0, 0.0]))
    ends = (
        (wall, rack, k.RACK_CYLINDER, k.AREA_A),
        (on(1, k.LIFT_FOOT[0], 0.0, k.LIFT_FOOT[1]), on(2, *g.on_lift(k.LIFT_HEAD)[:2]), k.LIFT_CYLINDER, k.AREA_B),
        (on(3, *g.on_lift(k.TILT_FOOT)[:2]), tip, k.TILT_CYLINDER, k.AREA_B),
    )
    forces = g.cylinder_forces(bodies, q)
    actuators = []
    for j, (foot, head, (shortest, stroke), area_b) in enumerate(ends):
        pressures = resting_pressures(float(forces[j]), k.AREA_A, area_b)
        actuators.append(_actuator(mbs, foot, head, shortest, stroke, area_b, pressures))
        _friction(mbs, foot, head, k.DRY[j])
    mbs.Assemble()
    return Model(mbs, tree, tuple(actuators))


def _tree(mbs: Any, bodies: tuple[g.Body, ...], q: Array) -> tuple[int, int]:
    """Seven revolute joints in minimal coordinates; passive ones with spring and damper."""
    node = mbs.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * 7,
            initialCoordinates=[float(x) for x in q],
            initialCoordinates_t=[0.0] * 7,
            numberOfODE2Coordinates=7,
        )
    )
    bracket = g.on_lift(k.BRACKET_PIVOT)
    offsets = ([0, 0, 0], [0, 0, 0], [g.A1, 0, g.D1], [0, 0, 0], [g.A2, 0, 0], [0, 0, 0], bracket)
    stiffness, damping = np.zeros(7), np.zeros(7)
    stiffness[list(g.SPRUNG)], damping[list(g.SPRUNG)] = k.SPRINGS, k.DAMPERS
    tree = mbs.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            jointTypes=[exu.JointType.RevoluteZ] * 7,
            linkParents=[-1, 0, 1, 2, 3, 4, 3],
            jointTransformations=exu.Matrix3DList([UPRIGHT if i == 2 else np.eye(3) for i in range(7)]),
            jointOffsets=exu.Vector3DList([np.array(one, dtype=float) for one in offsets]),
            linkInertiasCOM=exu.Matrix3DList([one.inertia for one in bodies]),
            linkCOMs=exu.Vector3DList([one.com for one in bodies]),
            linkMasses=[one.mass for one in bodies],
            gravity=[0.0, 0.0, -k.GRAVITY],
            jointPControlVector=stiffness,
            jointDControlVector=damping,
            jointPositionOffsetVector=np.zeros(7),
            jointVelocityOffsetVector=np.zeros(7),
            jointForceVector=np.zeros(7),
        )
    )
    return node, tree


def _rack(mbs: Any, tree_node: int) -> int:
    """The slewing rack, geared to the pillar; returns the marker on it."""
    node = mbs.AddNode(items.Node1D(referenceCoordinates=[0.0]))
    body = mbs.AddObject(items.ObjectMass1D(mass=k.RACK_KG, nodeNumber=node, referencePosition=[RACK_AT, 0.0, 0.0]))
    slew = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=tree_node, coordinate=0))
    along = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=0))
    mbs.AddObject(items.ObjectConnectorCoordinate(markerNumbers=[along, slew], factor1=k.PITCH_RADIUS))
    return mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body, localPosition=[0.0, 0.0, 0.0]))


def _actuator(
    mbs: Any, foot: int, head: int, shortest: float, stroke: float, area_b: float, pressures: tuple[float, float]
) -> int:
    """One double-acting cylinder with its chambers' pressures."""
    node = mbs.AddNode(
        items.NodeGenericODE1(
            referenceCoordinates=[0.0, 0.0], initialCoordinates=list(pressures), numberOfODE1Coordinates=2
        )
    )
    return mbs.AddObject(
        items.ObjectConnectorHydraulicActuatorSimple(
            markerNumbers=[foot, head],
            nodeNumbers=[node],
            offsetLength=shortest,
            strokeLength=stroke,
            chamberCrossSection0=k.AREA_A,
            chamberCrossSection1=area_b,
            hoseVolume0=k.HOSE_M3,
            hoseVolume1=k.HOSE_M3,
            actuatorDamping=k.VISCOUS,
            oilBulkModulus=k.OIL_PA,
            cylinderBulkModulus=k.CYLINDER_PA,
            hoseBulkModulus=k.HOSE_PA,
            nominalFlow=k.VALVE_FLOW,
            systemPressure=k.P_SUPPLY,
            tankPressure=k.P_TANK,
            useChamberVolumeChange=True,
        )
    )


def _friction(mbs: Any, foot: int, head: int, dry: float) -> None:
    """Dry friction along the cylinder, smooth through zero, with the Stribeck peak; evaluated inside Exudyn.

    Model:  F = dry sign(v) (Fc tanh(4 a) + (Fs - Fc) a / (a^2 / 4 + 3 / 4)^2), a = |v| / vs.
    Source: [P], after Brown and McPhee 2016.
    """
    sym = exu.symbolic

    def force(mbs: Any, t: Any, number: Any, u: Any, v: Any, stiffness: Any, damping: Any, offset: Any) -> Any:
        del mbs, t, number, u, stiffness, damping, offset
        a = sym.abs(v) / k.STRIBECK
        hump = 0.25 * a * a + 0.75
        return dry * (k.COULOMB * sym.tanh(4.0 * a) + (k.STATIC - k.COULOMB) * a / (hump * hump)) * sym.sign(v)

    spring = mbs.AddObject(
        items.ObjectConnectorSpringDamper(markerNumbers=[foot, head], referenceLength=1e-3, stiffness=0.0, damping=0.0)
    )
    function = CreateSymbolicUserFunction(mbs, force, "springForceUserFunction", spring)
    mbs.SetObjectParameter(spring, "springForceUserFunction", function)


def solve(model: Model, steps: int, before_step: Callable[[int], None]) -> None:
    """Integrate; `before_step(number)` is called at the start of each step, counted from 0.

    Where Newton does not converge, Exudyn halves a step and recovers after two: then nothing is told between.

    Raises: SolverError: it did not converge on the finest step either.
    """
    told = [-1]
    data, start = model.system.systemData, exu.ConfigurationType.StartOfStep

    def pre_step(_system: Any, _t: float) -> bool:
        number = int(data.GetTime(start) / STEP_S + 1e-6)
        if number > told[0]:
            told[0] = number
            before_step(number)
        return True

    model.system.SetPreStepUserFunction(pre_step)
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.numberOfSteps, integration.endTime = steps, steps * STEP_S
    integration.adaptiveStepRecoverySteps, integration.minimumStepSize = 2, STEP_S / 64.0
    integration.verboseMode = 0
    integration.newton.relativeTolerance, integration.newton.adaptInitialResidual = TOLERANCE, False
    integration.generalizedAlpha.spectralRadius = 0.8
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 1e9
    try:
        model.system.SolveDynamic(settings, solverType=exu.DynamicSolverType.GeneralizedAlpha)
    except Exception as error:  # Exudyn raises its own kinds
        raise SolverError(str(error)) from error
