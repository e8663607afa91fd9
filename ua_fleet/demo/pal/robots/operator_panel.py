"""A second computer in the arm's graph that turns the conveyor belt off at a given moment."""

from __future__ import annotations

import argparse
import sys
import time

from ua_fleet.demo.ros_node import connect, report


def main() -> None:
    """Switch the belt off when a line with the moment (seconds since 1970) comes on stdin."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ros", type=int, choices=(1, 2), default=1)
    options = parser.parse_args()
    node = connect(options.ros, "operator_panel")
    try:
        switch = node.publisher("/conveyor/switch", "std_msgs/Bool")
        switch(True)
        report("operator", "is ready")
        for line in sys.stdin:
            node.wait(float(line) - time.time())
            report("operator", "turns the conveyor off")
            switch(False)
        node.stopped.wait()
    finally:
        node.close()


if __name__ == "__main__":
    main()
