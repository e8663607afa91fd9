"""URScript, as far as programs for a simulated arm need it: read, checked, and run step by step. Pure.

    reading    text to a program: tokens and statements
    values     what variables hold, and what operators make of it
    nodes      statements and expressions that run themselves
    machine    the threads of one program
    receiving  where a program ends in what comes in through a socket

Not here: structs, sockets, XML-RPC, interpreter mode, `rpc_factory`, matrices. A program that uses them ends with an
error that names the line.
"""

from ua_demo.simulators.ur.urscript.machine import Machine
from ua_demo.simulators.ur.urscript.reading import read_program
from ua_demo.simulators.ur.urscript.receiving import ProgramReceiver
from ua_demo.simulators.ur.urscript.values import Pose, ScriptError, Value

__all__ = ["Machine", "Pose", "ProgramReceiver", "ScriptError", "Value", "read_program"]
