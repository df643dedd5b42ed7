"""The version of the installed application."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("longreach")
except PackageNotFoundError:  # run from a tree that was never installed
    __version__ = "0.0.0+source"
