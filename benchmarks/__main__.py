"""Run the benchmarks: `python -m benchmarks [--only GROUP [--part NAME]] [--rounds N]`.

Writes `results.json`, prints the same as a table, and ends with exit code 1 where a figure does not hold or a group
failed.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import BESIDE, FEWEST_ROUNDS, PART, Failed, Figure, Unavailable, merge_results

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
NO_GROUPS = {"__init__", "__main__", "harness", "report"}
WITH_PARTS = ("services",)


def groups() -> list[str]:
    """The modules here that are groups; what begins with an underscore belongs to one of them."""
    names = sorted(path.stem for path in HERE.glob("*.py"))
    return [name for name in names if name not in NO_GROUPS and not name.startswith("_")]


def run(group: str, rounds: int) -> list[Figure]:
    module = importlib.import_module(f"benchmarks.{group}")
    figures: list[Figure] = module.figures(rounds)
    if not figures:
        raise Failed("it has no such part")
    merge_results(RESULTS, group, figures)
    return figures


def print_table(results: dict[str, list[Figure]]) -> None:
    table = Table("figure", "value", "reference", "ratio", "goal", "holds", title="Benchmarks")
    for group, figures in results.items():
        for figure in figures:
            table.add_row(
                f"{group}: {figure.name}",
                f"{figure.value:.4g} {figure.unit}",
                f"{figure.reference_value:.4g} {figure.unit} ({figure.reference})",
                f"{figure.ratio:.2f}",
                "" if figure.goal is None else f"{figure.goal:g}",
                "yes" if figure.holds else "NO",
            )
    # Wide enough for whole rows where the output goes to a file.
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Figures beside a peer or a floor.")
    parser.add_argument("--only", choices=groups(), metavar="GROUP", help=f"one of {', '.join(groups())}")
    parser.add_argument("--rounds", type=int, default=FEWEST_ROUNDS, help=f"at least {FEWEST_ROUNDS}")
    parser.add_argument(
        "--beside",
        type=Path,
        metavar="CLONE",
        help="a clone of another commit, set up as this one, measured in turn with this one (actions, skill_start)",
    )
    parser.add_argument("--part", metavar="NAME", help="one part of the group, e.g. Connect (services)")
    arguments = parser.parse_args()
    if arguments.part is not None:
        if arguments.only is None:
            parser.error("--part is one of a group: name that with --only")
        if arguments.only not in WITH_PARTS:
            parser.error(f"{arguments.only} has no parts, as {', '.join(WITH_PARTS)} has")
        os.environ[PART] = arguments.part
    if arguments.beside is not None:
        os.environ[BESIDE] = str(arguments.beside.resolve())
    results: dict[str, list[Figure]] = {}
    failed: list[str] = []
    for group in [arguments.only] if arguments.only else groups():
        print(f"{group} ...", file=sys.stderr, flush=True)
        try:
            results[group] = run(group, arguments.rounds)
        except Unavailable as reason:
            print(f"{group}: skipped, {reason}", file=sys.stderr)
        except Failed as reason:
            print(f"{group}: failed, {reason}", file=sys.stderr)
            failed.append(group)
    print_table(results)
    return 0 if not failed and all(figure.holds for figures in results.values() for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
