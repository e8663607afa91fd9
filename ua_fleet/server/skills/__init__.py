"""Skills as OPC UA programs: their nodes, Methods, states and events.

program.py    states and transitions of OPC 10000-10
nodes.py      SkillType instances
tracker.py    what is known of executions: requests, answers and SkillStatus in, changes of nodes and events out (pure)
methods.py    Start and the other Methods
events.py     transitions as events of the Server object
"""
