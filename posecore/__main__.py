"""The command line: `python -m posecore evaluate | train | estimate`."""

from posecore.command_line import start

if __name__ == "__main__":
    start("posecore.methods.main")
