"""Skills: their executions, and the requests for them.

program.py     states and transitions of OPC 10000-10
executions.py  what is known of an execution, and how it is read from what robots say
tracked.py     one skill: its executions, its state, what its nodes show
tracker.py     all skills: requests, answers and SkillStatus in, changes of nodes and events out
commands.py    requests to robots by Actions, each with one outcome
router.py      requests to bridges or to clients
"""
