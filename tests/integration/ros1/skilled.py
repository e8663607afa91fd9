"""The skills of nodes/skilled.py, and a bridge with a requestor of commands that use them."""

from __future__ import annotations

from typing import Any, Final

SPACE: Final = 1
DRIVE, MOVE, HOLD, FAIL, NO, COUNT = 1010, 1011, 1012, 1013, 1014, 1015
STATUS: Final = 1000

SKILLS: dict[str, Any] = {
    "drive": {
        "id": DRIVE,
        "arguments": {"to": {"type": "String"}, "seconds": {"type": "Double", "default": 0.0}},
        "results": {"distance": {"type": "Double"}},
        "timeout_s": 10.0,
    },
    "move": {
        "id": MOVE,
        "arguments": {"speed": {"type": "Double"}},
        "timeout_s": 2.0,
        "via": {
            "topic": {
                "topic": "/move",
                "type": "geometry_msgs/Twist",
                "fields": {"speed": "linear.x"},
                "constants": {"angular.z": 0.5},
                "halt": {},
                "status": {
                    "topic": "/move_state",
                    "type": "std_msgs/String",
                    "running": "data == 'moving'",
                    "done": "data == 'arrived'",
                    "failed": "data == 'stuck'",
                    "message": "data",
                },
            }
        },
    },
    "hold": {
        "id": HOLD,
        "arguments": {"data": {"type": "Boolean"}},
        "timeout_s": 1.0,
        "via": {"service": {"name": "/hold", "type": "std_srvs/SetBool", "success": "success", "message": "message"}},
    },
    "fail": {"id": FAIL, "timeout_s": 5.0, "via": {"service": {"name": "/fail", "type": "std_srvs/Trigger"}}},
    "no": {
        "id": NO,
        "timeout_s": 5.0,
        "via": {"service": {"name": "/no", "type": "std_srvs/Trigger", "success": "success", "message": "message"}},
    },
    "count": {
        "id": COUNT,
        "arguments": {"tenths": {"type": "Int32"}},
        "results": {"counted": {"type": "Int32"}},
        "timeout_s": 6.0,
        "via": {
            "action": {
                "name": "/count",
                "type": "actionlib/Test",
                "fields": {"tenths": "goal"},
                "results": {"counted": "result"},
                "progress": "feedback / arguments.tenths",
            }
        },
    },
}
ROBOTS: dict[str, Any] = {"arm": {"bridge": "ros1", "skill_status_id": STATUS, "skills": SKILLS}}
