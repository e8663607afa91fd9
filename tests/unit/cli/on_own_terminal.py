"""The command line in a process whose stdin is the terminal that sends it Ctrl-C."""

import fcntl
import termios

from ua_fleet.cli import main

fcntl.ioctl(0, termios.TIOCSCTTY, 0)
main()
