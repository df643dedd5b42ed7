"""Print the server's dependencies of a pyproject.toml, one a line: a requirements file for the image's first layer."""

import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["project"]
sys.stdout.write("\n".join([*project["dependencies"], *project["optional-dependencies"]["server"]]) + "\n")
