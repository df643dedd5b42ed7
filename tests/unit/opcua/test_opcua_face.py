"""The OPC UA face, read by asyncua's own client; and what it shows, without it."""

import asyncio
import importlib.util
import math
import socket
import sys
from dataclasses import replace

import numpy as np
import pytest
from served import bench

from protocol.codes import FaultBit
from recording.clock import mono_ns
from server.errors import SettingsError
from server.faces import opcua as face_module
from server.faces.opcua import OpcUaValue, OperationalMode, check_opcua, opcua_face, opcua_values
from server.faces.shell import FACE_CONNECTIONS_MAX, running_face
from server.link.contracts import LinkHealth, LinkPhase, PlcSample
from server.settings import OpcUaSettings

needs_asyncua = pytest.mark.skipif(importlib.util.find_spec("asyncua") is None, reason="asyncua is not installed")
Q = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
PARAMETERS = ("MotionDeviceSystem", "MotionDevices", "MotionDevice_1")
SAFETY = ("MotionDeviceSystem", "SafetyStates", "SafetyState_1", "ParameterSet")
POSITION_2 = (*PARAMETERS, "Axes", "Axis_2", "ParameterSet", "ActualPosition")


def sample(t_mono_ns, q=Q, plc_state="RUN", fault_bits=0):
    zeros = (0.0,) * 6
    pressures = (zeros, zeros, 2.1e7, 40.0)
    return PlcSample(
        1, t_mono_ns, 1, q, zeros, q, zeros, zeros, *pressures, plc_state, 0, 0, 0, 0, 0, fault_bits, 0, True
    )


@pytest.fixture
def service(tmp_path):
    made = bench(tmp_path)
    made.service.cell.link.latest = sample(mono_ns())
    yield made.service
    made.keeper.database.close()


def by_path(service) -> dict[tuple[str, ...], OpcUaValue]:
    return {value.browse_path: value for value in opcua_values(service)}


def test_axes_are_in_degrees_with_their_names(service):
    found = by_path(service)
    for number, (joint, q) in enumerate(zip(service.cell.machine.joints, Q, strict=True), start=1):
        axis = (*PARAMETERS, "Axes", f"Axis_{number}")
        assert found[(*axis, "AssetId")].value == joint.name
        position = found[(*axis, "ParameterSet", "ActualPosition")]
        assert position.value == pytest.approx(math.degrees(q), abs=1e-4)
        assert (position.unece_unit_code, position.is_fresh) == ("DD", True)


def test_what_the_plc_has_not_told_lately_is_not_fresh(service):
    now_ns = service.cell.link.latest.t_mono_ns
    at = {
        age_s: {value.browse_path: value.is_fresh for value in opcua_values(service, now_ns + int(age_s * 1e9))}
        for age_s in (0.2, 0.3)
    }
    assert at[0.2][POSITION_2] is True
    assert at[0.3][POSITION_2] is False
    assert at[0.3][(*PARAMETERS, "Model")] is True  # nothing of the PLC's
    service.cell.link.latest = None
    assert by_path(service)[POSITION_2].is_fresh is False


def test_the_machine_tells_its_serial_number(service):
    assert by_path(service)[(*PARAMETERS, "SerialNumber")].value == ""
    service.cell.machine = replace(service.cell.machine, serial="HC-0042")
    assert by_path(service)[(*PARAMETERS, "SerialNumber")].value == "HC-0042"


def test_faults_are_told_as_the_companion_specification_names_them(service):
    service.cell.link.latest = sample(mono_ns(), fault_bits=int(FaultBit.ESTOP))
    found = by_path(service)
    assert (found[(*SAFETY, "EmergencyStop")].value, found[(*SAFETY, "ProtectiveStop")].value) == (True, False)
    service.cell.link.latest = sample(mono_ns(), fault_bits=int(FaultBit.LAG))
    found = by_path(service)
    assert (found[(*SAFETY, "EmergencyStop")].value, found[(*SAFETY, "ProtectiveStop")].value) == (False, True)
    assert found[(*SAFETY, "OperationalMode")].value == OperationalMode.AUTOMATIC_EXTERNAL
    service.cell.link.health = LinkHealth(LinkPhase.LOCAL, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 0)
    assert by_path(service)[(*SAFETY, "OperationalMode")].value == OperationalMode.OTHER


def test_the_paths_never_change(service):
    before = [value.browse_path for value in opcua_values(service)]
    service.cell.link.latest = None
    assert [value.browse_path for value in opcua_values(service)] == before
    assert len(set(before)) == len(before)


async def test_off_by_default_it_needs_nothing(service, monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    check_opcua(OpcUaSettings())
    async with opcua_face(service, OpcUaSettings()) as face:
        assert face is None
    with pytest.raises(SettingsError, match=r"pip install 'longreach\[opcua\]'"):
        check_opcua(OpcUaSettings(enabled=True))


def test_beyond_this_computer_it_must_be_wanted_without_keys(monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", object())
    with pytest.raises(SettingsError, match="without_keys"):
        check_opcua(OpcUaSettings(enabled=True, host="0.0.0.0"))
    check_opcua(OpcUaSettings(enabled=True, host="0.0.0.0", without_keys=True))
    check_opcua(OpcUaSettings(host="0.0.0.0"))


WHERE = """import asyncio, threading
try:
    asyncio.get_running_loop()
    looped = True
except RuntimeError:
    looped = False
"""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """A library that notes whether an event loop was running where it was imported; there is no server in it."""
    for name in [name for name in sys.modules if name.split(".")[0] == "asyncua"]:
        monkeypatch.delitem(sys.modules, name)
    deepest = tmp_path.joinpath(*face_module.ASYNCUA_ADDRESS_SPACE_MODULE.split(".")[:-1])
    deepest.mkdir(parents=True)
    for folder in (deepest, *deepest.parents[:3]):
        if folder != tmp_path:
            (folder / "__init__.py").write_text(WHERE)
    (deepest / "standard_address_space.py").write_text(WHERE)
    monkeypatch.syspath_prepend(tmp_path)
    yield lambda: {name: sys.modules[name].looped for name in sys.modules if name.startswith("asyncua")}
    for name in [name for name in sys.modules if name.split(".")[0] == "asyncua"]:
        del sys.modules[name]  # monkeypatch puts the real ones back


async def test_the_library_is_never_imported_by_the_loop(service, stand_in):
    assert stand_in() == {}
    with pytest.raises(AttributeError):  # it has no `ua`: what comes behind the import is another test's
        async with opcua_face(service, OpcUaSettings(enabled=True)):
            pass
    assert set(stand_in()) == {face_module.ASYNCUA_ADDRESS_SPACE_MODULE.rsplit(".", depth)[0] for depth in range(4)}
    assert set(stand_in().values()) == {False}


def test_checking_the_settings_loads_it_when_it_is_wanted_only(stand_in):
    check_opcua(OpcUaSettings())
    assert stand_in() == {}
    check_opcua(OpcUaSettings(enabled=True))
    assert face_module.ASYNCUA_ADDRESS_SPACE_MODULE in stand_in()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


async def node(client, path):
    index = await client.get_namespace_index(face_module.OPCUA_NAMESPACE_URI)
    return await client.nodes.objects.get_child([f"{index}:{name}" for name in path])


async def until(check):
    """For a moment: values are written behind our back."""
    for _ in range(500):
        if await check():
            return
        await asyncio.sleep(0.02)
    pytest.fail("it did not come about within 10 s")


@needs_asyncua
@pytest.mark.slow  # the library loads its address space: two seconds, ten on a busy computer
@pytest.mark.filterwarnings("ignore")  # of a library that is not ours
async def test_a_client_reads_everything_and_changes_nothing(service, monkeypatch):
    from asyncua import Client, ua

    monkeypatch.setattr(face_module, "OPCUA_UPDATE_PERIOD_S", 0.02)
    port = free_port()
    async with (
        opcua_face(service, OpcUaSettings(enabled=True, port=port)),
        Client(f"opc.tcp://127.0.0.1:{port}/longreach/", timeout=30.0) as client,
    ):
        service.cell.link.latest = sample(mono_ns() + 10**12)  # fresh for the whole test
        position = await node(client, POSITION_2)

        async def good():
            return (await position.read_data_value(raise_on_bad_status=False)).StatusCode.is_good()

        await until(good)
        for one in opcua_values(service):
            assert await (await node(client, one.browse_path)).read_value() == one.value, one.browse_path
        assert (
            await (await position.get_child([f"{position.nodeid.NamespaceIndex}:EngineeringUnits"])).read_value()
            == "DD"
        )

        service.cell.link.latest = sample(mono_ns() + 10**12, q=tuple(np.array(Q) + 0.25))

        async def followed():
            return await position.read_value() == pytest.approx(math.degrees(Q[1] + 0.25), abs=1e-4)

        await until(followed)

        for one in opcua_values(service):
            variable = await node(client, one.browse_path)
            with pytest.raises(ua.UaStatusCodeError):
                await variable.write_value(one.value)
            assert await variable.get_methods() == []
        system = await node(client, ("MotionDeviceSystem",))
        with pytest.raises(ua.UaStatusCodeError):
            await system.add_variable(2, "surprise", 1)

        service.cell.link.latest = sample(mono_ns() - 10**9)  # the PLC has fallen silent

        async def silent():
            value = await position.read_data_value(raise_on_bad_status=False)
            return value.StatusCode.value == ua.StatusCodes.BadNoCommunication

        await until(silent)


async def test_a_face_that_dies_is_told(service, caplog):
    async def dies():
        raise RuntimeError("gone")

    async with running_face("face", dies(), "values are no longer updated"):
        await asyncio.sleep(0.01)
    assert "values are no longer updated" in caplog.text


@needs_asyncua
async def test_idle_connections_leave_descriptors_for_a_stop(service):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    async with opcua_face(service, OpcUaSettings(enabled=True, port=port)), asyncio.timeout(30.0):
        opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(FACE_CONNECTIONS_MAX + 5)]
        for reader, _ in opened[FACE_CONNECTIONS_MAX:]:
            assert await reader.read() == b""
        assert not any(reader.at_eof() for reader, _ in opened[:FACE_CONNECTIONS_MAX])
        for _, writer in opened:
            writer.close()
