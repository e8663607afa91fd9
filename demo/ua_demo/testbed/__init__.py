"""The demonstrations with each process in a container of its own: what `compose.yaml` has them run.

`prepare` is the job that all others wait for, `robot` becomes what simulates a robot, `run` is the conductor, who
watches and commands by OPC UA as any client does, and `login` says what UaExpert needs.
"""
