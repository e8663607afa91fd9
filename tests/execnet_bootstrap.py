"""What execnet has a Python do that it starts: it is told the rest on stdin."""

import sys

exec(eval(sys.stdin.readline()))
