"""Robots that come and go while the server runs.

roster.py     which robots there are, and how they came: fleet.yaml, RegisterRobot, an announcement on PubSub
methods.py    RegisterRobot and UnregisterRobot
changes.py    GeneralModelChangeEvents of what has come and gone
offers.py     skills that OPC UA clients do: who offers which, what is asked of whom (pure)
offer_nodes.py  Fleet/Offers: its lists, Methods and events
summary_nodes.py  Fleet/Summaries: how the robots stand, a hundred in a Variable
router.py     requests for skills, to bridges or to clients
taking.py     all parts of the server that have to know of a robot
"""
