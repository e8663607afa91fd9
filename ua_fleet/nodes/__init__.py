"""The fleet as nodes: what clients browse, read, write, call and are told.

nodeset.py, address_space.py          the types, and the fleet's nodes
node_factory.py, method_factory.py    make Objects, Variables and Properties; Methods with plain arguments
projection.py                         changes of the fleet's state onto values and events, in their order
*_nodes.py                            the nodes of one part: skills, scenarios, summaries, offers ...
*_methods.py                          the Methods of one part
*_events.py, scenario_view.py         what happens, as events
"""
