"""ur-rtde, each use of it in a process of its own.

The library holds Python's interpreter lock while it connects, and waits without limit for a controller that accepts a
connection and says nothing; so inside the bridge it could stop the whole of it. Here it is a child that is ended when
it does not answer in time.

    child        the bridge's end: start it, read its lines with a limit, end it
    receiving    the child that reads the robot's state
    commanding   the child that commands it
    lines        what both children share: JSON lines on a pipe of their own, the end with the bridge
"""
