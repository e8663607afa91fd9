"""A fleet with one TCP robot, for the tests here."""

from __future__ import annotations

from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig

FILE = """\
version: 1
pubsub: {security: none}
bridges:
  cell:
    kind: tcp
    space: 300
    status_id: 1
    interpreter: {connect: "127.0.0.1:1025"}
    direct: {connect: "127.0.0.1:30002", language: urscript}
    answers: [other.temperature]
  side: {kind: tcp, space: 301, status_id: 2, interpreter: {connect: "127.0.0.1:1026"}}
robots:
  other: {bridge: side, data: {temperature: {id: 90, type: Double}}}
  arm:
    bridge: cell
    fault_id: 20
    skill_status_id: 21
    data:
      position: {id: 10, fields: {x: {type: Double}, y: {type: Double}}}
      count: {id: 11, type: Int16, source: {direct: {line: "COUNT {value}", ask: "COUNT?\\n", period_s: 1}}}
      speed: {id: 12, type: Double, origin: server, sink: {direct: {command: "speed({value:.2f})\\n"}}}
      text: {id: 13, type: String, origin: server}
    skills:
      work:
        id: 30
        timeout_s: 10
        arguments: {what: {type: String}, seconds: {type: Double}}
        results: {done: {type: String}, seconds: {type: Double}}
      move:
        id: 31
        timeout_s: 10
        arguments: {angle: {type: Double}, name: {type: String}}
        results: {reached: {type: Double}}
        via:
          direct:
            command: "movej({angle}, {name})\\n"
            done: "OK {reached}"
            failed: "ERR {message}"
            halt: "stopj()\\n"
            halted: "STOPPED"
      home: {id: 32, via: {direct: {command: "home()\\n"}}}
"""


def fleet(*replaced: tuple[str, str]) -> FleetConfig:
    """The fleet, with texts of `FILE` replaced; raises ConfigInvalid."""
    whole = FILE
    for old, new in replaced:
        assert old in whole
        whole = whole.replace(old, new)
    return load_content(whole.encode(), "fleet.yaml", {})
