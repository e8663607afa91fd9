"""Files of at most 400 lines and functions of at most 60: what is longer stands here, each with why it is.

A reason says what would be torn apart. Who makes something longer than that either splits it or says why not.
"""

from __future__ import annotations

import ast
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

import pytest

from tests import system
from tests.architecture.statements import statements

MOST_LINES: Final = 400
MOST_LINES_OF_A_FUNCTION: Final = 60
"""Without its docstring."""

STATE_MACHINE: Final = "one state machine: each of its transitions reads what the others write"
PEER: Final = "one end of a protocol: its messages share the state of one connection or writer"
WIRE: Final = "one form of the wire, read and written beside each other, with all checks of it"
CLIENT: Final = "one API: a short method for each thing that a user may ask for"
MODELS: Final = "models of one part of fleet.yaml or of a certificate, with the checks of their keys"
CASES: Final = "cases of one subject, which share one set-up"
STAND: Final = "what many tests stand on: one world, with all that can be done to it"

LONG_FILES: Final[dict[str, tuple[str, ...]]] = {
    STATE_MACHINE: (
        "ua_fleet/bridge/actions.py",
        "ua_fleet/bridge/core.py",
        "ua_fleet/carrier/engine.py",
        "ua_fleet/carrier/side.py",
        "ua_fleet/carrying/holder.py",
        "ua_fleet/fleet/state.py",
        "ua_fleet/operation/pubsub/connections.py",
        "ua_fleet/operation/robots/offers.py",
        "ua_fleet/operation/runs/carried.py",
        "ua_fleet/operation/runs/requests.py",
        "ua_fleet/orchestrator/orchestrator.py",
        "ua_fleet/relay/core.py",
        "ua_fleet/scenario/run.py",
        "ua_fleet/server/core.py",
        "ua_fleet/server/teleoperation/service.py",
        "ua_fleet/skill/requestor.py",
        "ua_fleet/skill/responder.py",
    ),
    PEER: (
        "bridges/ua_bridges/modbus/job.py",
        "bridges/ua_bridges/plugged/driver.py",
        "bridges/ua_bridges/tcp/interpreter.py",
        "demo/ua_demo/simulators/ur/controller.py",
        "ua_fleet/endpoint/monitoring.py",
        "ua_fleet/endpoint/processor.py",
        "ua_fleet/endpoint/subscription_services.py",
        "ua_fleet/endpoint/subscriptions.py",
        "ua_fleet/pubsub/announcer.py",
        "ua_fleet/pubsub/publisher.py",
        "ua_fleet/pubsub/subscriber.py",
        "ua_fleet/transport/mqtt/transport.py",
        "ua_fleet/transport/udp.py",
    ),
    WIRE: (
        "bridges/ua_bridges/ros/codec.py",
        "demo/ua_demo/simulators/ur/functions.py",
        "ua_fleet/scenario/facts.py",
        "ua_fleet/endpoint/scan.py",
        "ua_fleet/pubsub/security/envelope.py",
        "ua_fleet/scenario/read.py",
        "ua_fleet/wire/json/variants.py",
        "ua_fleet/wire/security.py",
    ),
    CLIENT: (
        "ua_fleet/client/fleet_client.py",
        "ua_fleet/client/scenarios.py",
        "ua_fleet/client/status.py",
        "ua_fleet/cli/cert.py",
        "ua_fleet/endpoint/node_builder.py",
    ),
    MODELS: (
        "bridges/ua_bridges/ur/config.py",
        "ua_fleet/config/schema.py",
        "ua_fleet/endpoint/certificates.py",
    ),
    CASES: (
        "tests/console/test_drive.py",
        "tests/integration/history/test_postgres.py",
        "tests/integration/server_model/test_history.py",
        "tests/integration/server_security/test_sessions.py",
        "tests/integration/server_security/test_subscriptions.py",
        "tests/integration/transport/test_udp.py",
        "tests/integration/ur/test_driver.py",
        "tests/unit/bridge/test_actions.py",
        "tests/unit/bridge/test_inlet.py",
        "tests/unit/bridges/ros1/test_skills.py",
        "tests/unit/bridges/ros1/test_source.py",
        "tests/unit/bridges/tcp/test_interpreter.py",
        "tests/unit/cli/test_pubsub_decode.py",
        "tests/unit/cli/test_users_and_certificates.py",
        "tests/unit/config/test_load.py",
        "tests/unit/dissect/test_annotate.py",
        "tests/unit/endpoint/test_certificates.py",
        "tests/unit/operation/runs/test_carried.py",
        "tests/unit/operation/runs/test_service.py",
        "tests/unit/orchestrator/test_orchestrator.py",
        "tests/unit/pubsub/security/test_envelope.py",
        "tests/unit/pubsub/test_subscriber.py",
        "tests/unit/relay/test_core.py",
        "tests/unit/scenario/test_run.py",
        "tests/unit/skill/test_requestor.py",
        "tests/unit/skill/test_responder.py",
        "tests/unit/teleoperation/test_control.py",
        "tests/unit/test_loop_rule_over_connections.py",
        "tests/unit/wire/json/test_data.py",
        "tests/unit/wire/test_security.py",
    ),
    STAND: (
        "tests/carried/world.py",
        "tests/contract/harness.py",
        "tests/integration/server_security/harness.py",
        "tests/system.py",
        "tests/teleoperation/stack.py",
        "tests/unit/skill/world.py",
    ),
}

WIRING: Final = "makes parts that need each other, in one order: a straight list without branches"
COMMAND: Final = "declares the options of a command, each with its help, and hands them on"
STORY: Final = "one story, told step by step: what comes first is what the next step needs"
TABLE: Final = "a table of cases, or of Methods with their arguments"
SUBJECT: Final = "the program that a benchmark measures, which stands alone"

LONG_FUNCTIONS: Final[dict[str, tuple[str, ...]]] = {
    WIRING: (
        "ua_fleet/carrier/engine.py:__init__",
        "ua_fleet/config/transports.py:open_transport",
        "ua_fleet/endpoint/hardened_server.py:create_server",
        "ua_fleet/operation/runs/service.py:__init__",
        "ua_fleet/pubsub/remote_writer.py:__init__",
        "ua_fleet/pubsub/subscriber.py:__init__",
        "ua_fleet/server/ground.py:make_ground",
        "ua_fleet/server/pubsub_setup.py:make_pubsub_model",
        "ua_fleet/server/scenario_setup.py:make_scenarios",
        "tests/integration/server_security/harness.py:build",
    ),
    COMMAND: (
        "demo/ua_demo/commands/pal.py:pal",
        "demo/ua_demo/commands/talkrobots.py:talkrobots",
        "ua_fleet/cli/app.py:_build",
        "ua_fleet/cli/bridge.py:bridge",
        "ua_fleet/cli/pubsub.py:listen",
        "ua_fleet/cli/pubsub_replay.py:replay",
    ),
    TABLE: (
        "tests/attacks/test_after_login.py:test_nulls_beside_what_there_is_are_answered",
        "ua_fleet/cli/status_text.py:status_lines",
        "ua_fleet/endpoint/certificates.py:create_certificate",
        "ua_fleet/endpoint/processor.py:_dispatch",
    ),
    STORY: (
        "tests/console/test_away.py:test_scenarios_and_runs",
        "tests/console/test_keyboard.py:test_a_scenario_is_found_started_followed_and_ended",
        "tests/integration/monitoring/test_processes.py:test_from_start_to_end",
        "tests/integration/robot_to_robot/test_robot_to_robot.py:test_a_plc_has_a_drone_fly",
        "tests/integration/ur/test_page.py:test_the_pages_fleet_runs_secured",
        "tests/interop/test_o6.py:test_json_key_frames_over_a_broker",
    ),
    SUBJECT: ("benchmarks/_ingest.py:ours", "benchmarks/_summaries.py:server"),
}


@cache
def sources() -> tuple[Path, ...]:
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.py"],
        cwd=system.ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip(f"git tells no files: {listed.stderr.strip()}")
    paths = [system.ROOT / line for line in listed.stdout.splitlines()]
    return tuple(path for path in paths if path.is_file())


def functions(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """The name of each function, and its lines without its docstring."""
    for node in statements(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.end_lineno is None:
            continue
        size, first = node.end_lineno - node.lineno + 1, node.body[0]
        if ast.get_docstring(node, clean=False) is not None and first.end_lineno is not None:
            size -= first.end_lineno - first.lineno + 1
        yield node.name, size


def listed(reasons: dict[str, tuple[str, ...]]) -> set[str]:
    names = [name for names in reasons.values() for name in names]
    assert len(names) == len(set(names)), "something has two reasons"
    return set(names)


def name_of(path: Path) -> str:
    return path.relative_to(system.ROOT).as_posix()


def test_long_files_have_a_reason() -> None:
    long = {name_of(path) for path in sources() if len(path.read_text("utf-8").splitlines()) > MOST_LINES}
    assert long - listed(LONG_FILES) == set(), f"more than {MOST_LINES} lines: split them, or say why they are so long"
    assert listed(LONG_FILES) - long == set(), "these are not long any more"


def test_long_functions_have_a_reason() -> None:
    long = {
        f"{name_of(path)}:{name}"
        for path in sources()
        for name, size in functions(ast.parse(path.read_text("utf-8")))
        if size > MOST_LINES_OF_A_FUNCTION
    }
    assert long - listed(LONG_FUNCTIONS) == set(), (
        f"more than {MOST_LINES_OF_A_FUNCTION} lines: split them, or say why they are so long"
    )
    assert listed(LONG_FUNCTIONS) - long == set(), "these are not long any more"
