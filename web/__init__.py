"""The operator panel: a static page (knows the server by REST and WebSocket only) and the 3D scene (no command)."""

from pathlib import Path

STATIC_FOLDER = Path(__file__).parent / "static"
