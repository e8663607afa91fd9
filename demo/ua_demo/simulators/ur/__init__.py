"""A Universal Robots controller without a robot, on the ports of a real one.

    python -m ua_demo.simulators.ur --host 127.0.0.2 --model ur5e

    29999   dashboard server          30003   realtime state out, URScript in
    30001   primary client            30004   RTDE, protocol version 2
    30002   secondary client          30005   what only a simulator has: stops that are provoked, inputs that are set

What comes in as URScript is interpreted, ur-rtde's control program included. Moves take the time that their speed and
acceleration ask for, over the kinematics of the chosen model. There is no dynamics: no gravity, forces, payload, blends
or collisions. `docs/ur.md` says what else a real controller does and this one does not.

    kinematics  motion  arm      the arm: pure, the time is an argument
    urscript/                    programs
    controller                   modes, safety, program, inputs and outputs, registers; pure
    variables  rtde              RTDE, bytes in and bytes out
    dashboard  realtime  primary provoking      the other ports: lines and packets
    server                       the sockets and the clock
"""
