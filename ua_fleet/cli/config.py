"""`ua-fleet config`: the configuration file."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ua_fleet.cli.endings import EXIT_USAGE
from ua_fleet.cli.options import DEFAULT_CONFIG, Json
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.errors import ConfigError, ConfigInvalid

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.document import Document

__all__ = [
    "CHECK_EXAMPLES",
    "IDS_EXAMPLES",
    "INIT_EXAMPLES",
    "SCHEMA_EXAMPLES",
    "assign",
    "check",
    "init",
    "schema",
]

INIT_EXAMPLES = ("ua-fleet config init", "ua-fleet config init hall2.yaml")
CHECK_EXAMPLES = ("ua-fleet config check", "ua-fleet config check --ros", "ua-fleet config check hall2.yaml --json")
SCHEMA_EXAMPLES = (
    "ua-fleet config schema -o fleet.schema.json",
    "ua-fleet config schema --scenario -o scenarios/scenario.schema.json",
)
IDS_EXAMPLES = ("ua-fleet config assign-ids", "ua-fleet config assign-ids hall2.yaml --json")

File = Annotated[Path, typer.Argument(help="The configuration file.", envvar="UA_FLEET_CONFIG")]

Installed = Annotated[
    bool,
    typer.Option(
        "--ros", help="Also check mapped topics against the message types that are installed on this machine."
    ),
]

Scenarios = Annotated[bool, typer.Option(help="Check the scenarios in the fleet's folder as well.")]


@dataclass(frozen=True, slots=True)
class _Size:
    bridges: int
    robots: int
    data_sources: int

    @classmethod
    def of(cls, config: FleetConfig) -> _Size:
        """What a fleet consists of."""
        data_sources = sum(len(robot.data) for robot in config.robots.values())
        return cls(len(config.bridges), len(config.robots), data_sources)


def _as_json(problem: ConfigError) -> dict[str, Any]:
    return {
        "file": problem.file,
        "line": problem.line or None,
        "key": problem.key,
        "message": problem.message,
        "suggestion": problem.suggestion,
    }


def init(file: File = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """Write a commented configuration file to start from.

    The file shows every key, with examples of bridges and robots. It is not valid until you decide on one key:
    `pubsub.security`. Its JSON Schema is written beside it, with which editors complete and check the file.
    """
    from ua_fleet.config.default_file import write_default, write_schema

    write_default(file)
    beside = write_schema(file.parent)
    if as_json:
        print_json({"file": str(file), "schema": str(beside)})
    else:
        print_line(str(file))
        print_line(str(beside))
    message(f"edit it, then run: ua-fleet config check {file}")


def _problems_of_scenarios(config: FleetConfig, folder: Path) -> Sequence[ConfigError]:
    from ua_fleet.config.nodes import fleet_model
    from ua_fleet.operation.runs.library import Library
    from ua_fleet.operation.runs.values import FleetValues, fleet_view

    model = fleet_model(config)
    view = fleet_view(model.robots, FleetValues(model).meanings)
    return Library(folder / config.scenarios.folder).problems(view)


def _loaded(file: Path) -> tuple[FleetConfig, Document]:
    from ua_fleet.config.load import load_document, read_content

    return load_document(read_content(file), str(file), os.environ)


def _findings_here(config: FleetConfig, document: Document) -> tuple[list[ConfigError], list[ConfigError]]:
    """What is wrong by what is installed here, and of what this machine cannot tell."""
    doubts: list[ConfigError] = []
    for name, bridge in config.bridges.items():
        for path, finding in bridge.findings_here(name, config.robots):
            document.problem(path, finding.text, finding.suggestion)
            if finding.is_doubt:
                doubts.append(document.problems.pop())
    return document.problems, doubts


def check(
    file: File = DEFAULT_CONFIG, scenarios: Scenarios = True, ros: Installed = False, as_json: Json = False
) -> None:
    """Check a configuration file and print all its problems, each with its line and a suggestion.

    The scenarios in its folder are checked against the fleet as well; robots that are registered while the server runs
    are not known here. The environment counts as for the server: ${VAR} in the file, and variables like
    UA_FLEET__SERVER__PORT. The exit code is 2 if there are problems.

    With --ros, the message type of each mapped topic and each path of a field in it are looked up as well, for ROS 1
    and ROS 2 alike; ROS does not have to run. A type whose package is not installed on this machine is reported, and is
    no problem: the bridge may run elsewhere.
    """
    from ua_fleet.config.connections import unstartable
    from ua_fleet.config.state_folders import unfit_folders

    doubts: list[ConfigError] = []
    try:
        config, document = _loaded(file)
        problems = list(_problems_of_scenarios(config, file.parent)) if scenarios else []
        if ros:
            found, doubts = _findings_here(config, document)
            problems = [*found, *problems]
    except ConfigInvalid as error:
        config, problems = None, list(error.problems)
    not_checked = {"not_checked": [_as_json(doubt) for doubt in doubts]} if ros else {}
    for doubt in doubts if not as_json else ():
        message(f"not checked: {doubt}")
    if config is None or problems:
        if as_json:
            print_json({"valid": False, "problems": [_as_json(problem) for problem in problems], **not_checked})
        else:
            for problem in problems:
                print_line(str(problem))
            many = len(problems) > 1
            again = f"ua-fleet config check {'--ros ' if ros else ''}{file}"
            remedy = f"correct {'them' if many else 'it'}, then run: {again}"
            message(f"ua-fleet: {len(problems)} problem{'s' if many else ''}; {remedy}")
        raise typer.Exit(EXIT_USAGE)
    size = _Size.of(config)
    for line in unstartable(config):
        message(line)
    for unfit in unfit_folders(config, file.parent):
        message(f"no backup is possible: {unfit}")
    if as_json:
        print_json(
            {
                "valid": True,
                "bridges": size.bridges,
                "robots": size.robots,
                "data_sources": size.data_sources,
                "problems": [],
                **not_checked,
            }
        )
    else:
        print_line(f"{file}: valid; bridges: {size.bridges}, robots: {size.robots}, data sources: {size.data_sources}")


def assign(file: File = DEFAULT_CONFIG, as_json: Json = False) -> None:
    """Give the next id to each data source and bridge without one, and write the ids into the file.

    Nothing else in the file changes, not even a space. Ids are addresses that clients remember: do not change an id,
    and do not use it again for something else.
    """
    from ua_fleet.config.assign_ids import assign_ids

    given = assign_ids(file)
    if as_json:
        print_json({"assigned": given})
        return
    for key, number in given.items():
        print_line(f"{key}: {number}")
    message(f"{file}: {len(given)} ids assigned" if given else f"{file}: nothing to do, all ids exist")


def schema(
    scenario: Annotated[
        bool, typer.Option("--scenario", help="Print the schema of scenario files instead of that of fleet.yaml.")
    ] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write it to this file.")] = None,
) -> None:
    """Print the JSON Schema of the configuration file, with the keys of all kinds of bridges that are installed.

    Editors complete and check the file with it, when its first line names it:
    # yaml-language-server: $schema=fleet.schema.json
    """
    from ua_fleet.config.json_schema import fleet_schema, schema_text
    from ua_fleet.scenario.json_schema import scenario_schema

    text = schema_text(scenario_schema() if scenario else fleet_schema())
    if output is None:
        sys.stdout.write(text)
        return
    from ua_fleet.config.default_file import write_text

    write_text(output, text)
    print_line(str(output))
