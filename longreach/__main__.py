"""`python -m longreach`: the command, never with a file of the working folder in a package's place."""

import os
import sys

# Python puts the working folder first on its path for -m, and a machine.py or server.py there would hide ours.
if not sys.flags.safe_path and sys.path and sys.path[0] in ("", os.getcwd()):
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    sys.path[0:1] = [here] if here == os.getcwd() else []

from longreach.cli import main

main()
