"""What a server decides: what is asked of robots, who does what, who may drive. Time and what is heard are arguments.

skills/    executions and their states; requests for skills and what became of them
robots/    which robots there are, and skills that OPC UA clients do
runs/      the orchestrator with its journal: runs, faults, decisions, and what they wait for
leases.py  who drives which robot by hand
"""
