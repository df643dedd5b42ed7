"""The versions of the installed application, and of the libraries whose numbers are in its results."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("longreach")
except PackageNotFoundError:  # run from a tree that was never installed
    __version__ = "0.0.0+source"

NUMERIC_PACKAGES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless")


def library_versions() -> list[tuple[str, str]]:
    """Name and version of each library that computes; "absent" where it is not installed."""
    found = []
    for name in NUMERIC_PACKAGES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "absent"))
    return found
