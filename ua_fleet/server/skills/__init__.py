"""Skills as OPC UA programs: their nodes, Methods, states and events.

program.py    states and transitions of OPC 10000-10
nodes.py      SkillType instances
executions.py what is known of an execution, and how it is read from what robots say (pure)
tracked.py    one skill: its executions, its state, what its nodes show (pure)
tracker.py    all skills: requests, answers and SkillStatus in, changes of nodes and events out (pure)
methods.py    Start and the other Methods
events.py     transitions as events of the Server object
"""
