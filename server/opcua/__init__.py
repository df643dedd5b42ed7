"""A read-only OPC UA face with the names of OPC 40010-1 (Robotics). Off by default; needs the extra `opcua`."""
