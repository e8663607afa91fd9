"""`python -m ua_fleet.cli`: the command line in an interpreter chosen by the caller."""

from ua_fleet.cli import main

if __name__ == "__main__":
    main()
