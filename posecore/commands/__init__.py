"""What the command line can do besides measuring: a module for each method that it trains.

This room alone, with `posecore/__main__.py`, may know `data_tools`: it joins datasets with methods.
"""
