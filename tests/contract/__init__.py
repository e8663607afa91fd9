"""One suite that every driver passes, against a robot that knows nothing of the bridge.

    python -m pytest tests/contract                                          the drivers of the main environment
    .venv-ros1/bin/python -m pytest tests/contract --drivers=ros1 -p no:cacheprovider

A driver takes part through a module here that is named in `conftest.DRIVERS` and has

    NEEDS: tuple[str, ...]                  parts of the system without which it is skipped (see tests/system.py)
    WARNINGS: tuple[str, ...]               warnings of foreign packages that are no errors (pytest's filterwarnings)
    open_space(folder, processes)           an asynchronous context manager for a `harness.Space`: robots with topics
    open_mapped_space(folder, processes)    the same for a `harness.MappedSpace`: robots without topics
    open_skilled_space(folder, processes)   the same for a `harness.SkilledSpace`: the driver's robots have skills
    open_driven_space(folder, processes)    the same for a `harness.DrivenSpace`: the driver's robots are driven by hand

The Space makes drivers, brings the robots' side up, and has a Robot. The robot is another process (or in memory, for
the virtual driver) and speaks the line protocol of `harness.RobotProcess`. `virtual.py` is the shortest example.
"""
