"""What bridges that carry a run ask people, as dialogs of the server: who takes over, and what became of a task."""

from __future__ import annotations

import asyncio
import signal

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.carried_runs import THREE, mutual, reason_of, run_carried, told_by
from tests.integration.scenarios.conftest import Plant, all_heard, open_decision, run_is
from tests.integration.server_model.harness import ua, until


async def test_who_takes_over_is_chosen_by_the_dialog_of_a_carried_run(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: two", "work: heavy"))
    plant.machines["middle"].weaken()
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            decision = await open_decision(client)
            dialog = client.get_node(f"ns=2;s=Dialogs.decision.{decision}")
            offered = client.get_node(f"ns=2;s=Dialogs.decision.{decision}.ResponseOptionSet").read_value
            # The left one is still at work for the bridge that ranks until it hears that it is not.
            await until(offered, lambda options: [one.Text for one in options] == ["left", "right"], timeout_s=20)
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await dialog.call_method("0:Respond", ua.Variant(2, ua.VariantType.Int32))
            assert refused.value.code == ua.StatusCodes.BadDialogResponseInvalid
            await dialog.call_method("0:Respond", ua.Variant(0, ua.VariantType.Int32))
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
            assert plant.told()[2:] == [("left", "heavy"), ("right", "heavy")], "the bridge has taken what was chosen"
            last = client.get_node(f"ns=2;s=Dialogs.decision.{decision}.LastResponse")
            assert await until(last.read_value, lambda response: response == 0, timeout_s=60) == 0
            with pytest.raises(ua.UaStatusCodeError) as late:
                await dialog.call_method("0:Respond", ua.Variant(1, ua.VariantType.Int32))
            assert late.value.code == ua.StatusCodes.BadDialogNotActive


async def test_a_task_of_a_carried_run_that_nobody_knows_the_end_of_is_asked_about_by_a_dialog(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 1"))
    plant.users()
    server = plant.server_process()
    bridges = {robot: plant.bridge(robot) for robot in plant.machines}
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), lambda told: len(told) == 2, timeout_s=60)
        bridges["middle"].process.send_signal(signal.SIGKILL)
        await asyncio.to_thread(bridges["middle"].process.wait)
        plant.machines["middle"].forget()
        plant.bridge("middle")
        await until(lambda: shown(client, run_id), lambda prompt: "was second (work on middle) done?" in prompt, 60)
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)
    plant.server_process()
    async with plant.client() as client:
        await until(lambda: shown(client, run_id), lambda prompt: "was second (work on middle) done?" in prompt, 60)
        dialog = client.get_node(f"ns=2;s=Dialogs.question.{run_id}.1")
        options = await client.get_node(f"ns=2;s=Dialogs.question.{run_id}.1.ResponseOptionSet").read_value()
        retry = [option.Text for option in options].index("retry")
        await open_decision(client)  # the bridge that asks has answered the new server
        await dialog.call_method("0:Respond", ua.Variant(retry, ua.VariantType.Int32))
        assert await run_is(client, run_id, "done", "failed", "aborted") == "done", await reason_of(client, run_id)
        assert plant.told() == [("left", "one"), ("middle", "two"), ("middle", "two"), ("right", "two")]
        with pytest.raises(ua.UaStatusCodeError) as late:
            await dialog.call_method("0:Respond", ua.Variant(retry, ua.VariantType.Int32))
        assert late.value.code == ua.StatusCodes.BadDialogNotActive


async def shown(client: Client, run_id: str) -> str:
    """The question about the second task; empty while there is none."""
    try:
        prompt = await client.get_node(f"ns=2;s=Dialogs.question.{run_id}.1.Prompt").read_value()
    except ua.UaStatusCodeError:
        return ""
    return str(prompt.Text)
