"""The command line: `python -m data_tools make | show | export | check | models_info | clean`."""

from posecore.command_line import start

if __name__ == "__main__":
    start("data_tools.main")
