"""A requestor as a process that is killed: `asking.py FLEET_JSON REQUESTOR_FOLDER EXECUTION_ID WORK SECONDS`."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from tests.integration.actions.conftest import QUICK_ACTION, TIMEOUT_S
from tests.integration.actions.requesting import requesting
from ua_fleet.config.schema import FleetConfig


async def main(fleet: Path, folder: Path, execution_id: bytes, work: str, seconds: float) -> None:
    config = FleetConfig.model_validate_json(fleet.read_text())
    async with requesting(config, folder) as requestor:
        outcome = await requestor.invoke(QUICK_ACTION, (work, seconds), TIMEOUT_S, execution_id)
        print(outcome.kind, flush=True)


asyncio.run(main(Path(sys.argv[1]), Path(sys.argv[2]), bytes.fromhex(sys.argv[3]), sys.argv[4], float(sys.argv[5])))
