"""The command line: `python -m posecore evaluate | train | estimate`."""

import sys

from posecore.methods.main import main

if __name__ == "__main__":
    sys.exit(main())
