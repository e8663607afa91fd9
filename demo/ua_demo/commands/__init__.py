"""The commands of the demonstrations, which join `ua-fleet` as entry points of the group `ua_fleet.commands`.

Each of `demo`, `simulate` and `testbed` has an `app`; none imports more at its start than help and completion need.
"""
