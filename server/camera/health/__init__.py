"""Health of the camera: every fault found, named with its remedy, and kept out of the looks."""

from server.camera.health.blur import sharpness
from server.camera.health.findings import FaultCode, Finding
from server.camera.health.image_health import ImageHealth
from server.camera.health.stamps import silence

__all__ = ["FaultCode", "Finding", "ImageHealth", "sharpness", "silence"]
