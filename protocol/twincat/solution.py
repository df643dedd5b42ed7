"""Project and solution around the exported TwinCAT files: XAE opens them, and builds, in one step.

The forms are those that TwinCAT 3.1 (build 4024) writes. Ids are fixed, so that a newer export replaces an older one.
"""

import uuid
from collections.abc import Iterable
from xml.sax.saxutils import escape, quoteattr

from protocol.twincat.parameters import PlcParameters

PLC_PROJECT_NAME = "HmPlc"
PLC_TASK_NAME = "PlcTask"
PLC_TASK_PRIORITY = 20  # XAE's own for a first PLC task
TWINCAT_LIBRARIES = (("Tc2_Standard", "Beckhoff Automation GmbH"), ("Tc2_System", "Beckhoff Automation GmbH"))
#: Blocks of other transports than EAP: listed, but left out of the build until their product's library is added.
EXCLUDED_FUNCTION_BLOCKS = frozenset({"FB_HmUdpTf6310", "FB_HmUdpTf6311"})
_XAE_PROJECT = "{B1E792BE-AA5F-4E3C-8C82-674BF9C0715B}"  # TwinCAT's kind of project in a Visual Studio solution
_PLC_CLASS = "{08500001-0000-0000-F000-000000000064}"
_PLC_INSTANCE, _PLC_TASK_POU, _TASK_OBJECT = "#x08502000", "#x08502001", "#x02010030"  # of the first PLC and task
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "solution.hmlink.longreach")
_CONFIGURATIONS = tuple(f"{kind}|TwinCAT RT ({cpu})" for kind in ("Debug", "Release") for cpu in ("x64", "x86"))


def solution_files(parameters: PlcParameters, paths: Iterable[str]) -> dict[str, bytes]:
    """The files in addition to the program's own, path to bytes: task, PLC project, TwinCAT project, solution.

    Args: paths: the program's files, such as "POUs/MAIN.TcPOU", with "/".
    """
    listed = (f"{PLC_TASK_NAME}.TcTTO", *sorted(paths))
    texts = {
        f"{PLC_TASK_NAME}.TcTTO": _task_xml(parameters),
        f"{PLC_PROJECT_NAME}.plcproj": _plc_project(listed),
        f"{PLC_PROJECT_NAME}.tsproj": _twincat_project(parameters),
        f"{PLC_PROJECT_NAME}.sln": _solution_file_text(),
    }
    return {path: text.encode("utf-8") for path, text in texts.items()}


def _object_guid(what: str) -> str:
    return "{" + str(uuid.uuid5(_NAMESPACE, what)) + "}"


def _task_xml(parameters: PlcParameters) -> str:
    ids = "".join(
        f"    <{tag}>{_object_guid(tag)}</{tag}>\n" for tag in ("TaskFBGuid", "Fb_init", "Fb_exit", "CycleUpdate")
    )
    return f"""\
<?xml version="1.0" encoding="utf-8"?>
<TcPlcObject Version="1.1.0.1">
  <Task Name={quoteattr(PLC_TASK_NAME)} Id={quoteattr(_object_guid(PLC_TASK_NAME))}>
    <!--CycleTime in micro seconds.-->
    <CycleTime>{parameters.cycle_ns // 1000}</CycleTime>
    <Priority>{PLC_TASK_PRIORITY}</Priority>
    <PouCall>
      <Name>MAIN</Name>
    </PouCall>
{ids}    <PostCycleUpdate>{_object_guid("PostCycleUpdate")}</PostCycleUpdate>
  </Task>
</TcPlcObject>
"""


def _plc_project(listed: Iterable[str]) -> str:
    files = tuple(listed)
    folders = sorted({path.rpartition("/")[0] for path in files} - {""})
    options = ("Application", "TypeSystem", "Implicit_Task_Info", "Implicit_KindOfTask", "Implicit_Jitter_Distribution")
    ids = "".join(f"    <{tag}>{_object_guid(tag)}</{tag}>\n" for tag in (*options, "LibraryReferences"))
    compiled = "".join(_compile_entry(path) for path in files)
    made = "".join(f"    <Folder Include={quoteattr(folder)} />\n" for folder in folders)
    libraries = "".join(_library_reference(name, company) for name, company in TWINCAT_LIBRARIES)
    return f"""\
<?xml version="1.0" encoding="utf-8"?>
<Project DefaultTargets="Build" xmlns="http://schemas.microsoft.com/developer/msbuild/2003">
  <PropertyGroup>
    <FileVersion>1.0.0.0</FileVersion>
    <SchemaVersion>2.0</SchemaVersion>
    <ProjectGuid>{_object_guid(PLC_PROJECT_NAME)}</ProjectGuid>
    <SubObjectsSortedByName>True</SubObjectsSortedByName>
    <Name>{PLC_PROJECT_NAME}</Name>
    <ProgramVersion>3.1.4024.0</ProgramVersion>
{ids}  </PropertyGroup>
  <ItemGroup>
{compiled}  </ItemGroup>
  <ItemGroup>
{made}  </ItemGroup>
  <ItemGroup>
{libraries}  </ItemGroup>
</Project>
"""


def _compile_entry(path: str) -> str:
    block = path.rpartition("/")[2].partition(".")[0]
    left_out = "      <ExcludeFromBuild>true</ExcludeFromBuild>\n" if block in EXCLUDED_FUNCTION_BLOCKS else ""
    windows = path.replace("/", "\\")
    return f"    <Compile Include={quoteattr(windows)}>\n      <SubType>Code</SubType>\n{left_out}    </Compile>\n"


def _library_reference(name: str, company: str) -> str:
    return f"""\
    <PlaceholderReference Include={quoteattr(name)}>
      <DefaultResolution>{escape(f"{name}, * ({company})")}</DefaultResolution>
      <Namespace>{name}</Namespace>
    </PlaceholderReference>
"""


def _twincat_project(parameters: PlcParameters) -> str:
    schema = "http://www.beckhoff.com/schemas/2012/07/TcSmProject"
    files = f'PrjFilePath="{PLC_PROJECT_NAME}.plcproj" TmcFilePath="{PLC_PROJECT_NAME}.tmc" ReloadTmc="true"'
    cycle_100ns, cycle_ns = parameters.cycle_ns // 100, parameters.cycle_ns
    return f"""\
<?xml version="1.0"?>
<TcSmProject xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="{schema}" \
TcSmVersion="1.0" TcVersion="3.1.4024.0">
  <Project ProjectGUID="{_object_guid("tsproj")}" Target64Bit="true" ShowHideConfigurations="#x3c7">
    <System>
      <Tasks>
        <Task Id="3" Priority="{PLC_TASK_PRIORITY}" CycleTime="{cycle_100ns}" AmsPort="350" AdtTasks="true">
          <Name>{PLC_TASK_NAME}</Name>
        </Task>
      </Tasks>
    </System>
    <Plc>
      <Project GUID="{_object_guid(PLC_PROJECT_NAME)}" Name="{PLC_PROJECT_NAME}" {files} AmsPort="851" \
FileArchiveSettings="#x000e" SymbolicMapping="true">
        <Instance Id="{_PLC_INSTANCE}" TcSmClass="TComPlcObjDef" KeepUnrestoredLinks="2" \
TmcPath="{PLC_PROJECT_NAME}.tmc">
          <Name>{PLC_PROJECT_NAME} Instance</Name>
          <CLSID ClassFactory="TcPlc30">{_PLC_CLASS}</CLSID>
          <Contexts>
            <Context>
              <Id>0</Id>
              <Name>{PLC_TASK_NAME}</Name>
              <ManualConfig>
                <OTCID>{_TASK_OBJECT}</OTCID>
              </ManualConfig>
              <Priority>{PLC_TASK_PRIORITY}</Priority>
              <CycleTime>{cycle_ns}</CycleTime>
            </Context>
          </Contexts>
          <TaskPouOids>
            <TaskPouOid Prio="{PLC_TASK_PRIORITY}" OTCID="{_PLC_TASK_POU}"/>
          </TaskPouOids>
        </Instance>
      </Project>
    </Plc>
  </Project>
</TcSmProject>
"""


def _solution_file_text() -> str:
    project = _object_guid("tsproj").upper()
    known = "".join(f"\t\t{each} = {each}\n" for each in _CONFIGURATIONS)
    built = "".join(
        f"\t\t{project}.{each}.{what} = {each}\n" for each in _CONFIGURATIONS for what in ("ActiveCfg", "Build.0")
    )
    return f"""\
Microsoft Visual Studio Solution File, Format Version 12.00
# TcXaeShell Solution File, Format Version 11.00
VisualStudioVersion = 15.0.27130.2036
MinimumVisualStudioVersion = 10.0.40219.1
Project("{_XAE_PROJECT}") = "{PLC_PROJECT_NAME}", "{PLC_PROJECT_NAME}.tsproj", "{project}"
EndProject
Global
\tGlobalSection(SolutionConfigurationPlatforms) = preSolution
{known}\tEndGlobalSection
\tGlobalSection(ProjectConfigurationPlatforms) = postSolution
{built}\tEndGlobalSection
\tGlobalSection(SolutionProperties) = preSolution
\t\tHideSolutionNode = FALSE
\tEndGlobalSection
EndGlobal
"""
