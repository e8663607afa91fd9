"""A PLC on pymodbus's server with the handshake of docs/plc.md: `plc_belt.py PORT`.

Holding registers: 0 request, 1 accepted, 2 busy, done and error (bits 0 to 2), 4 and 5 the job, 10 to 29 the text of
the error. Prints `begun JOB`, `done JOB`, `refused JOB`.
"""

import asyncio
import sys

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.saying import say

REQUEST, ACCEPTED, STATE, JOB, TEXT = 0, 1, 2, 4, 10
BUSY, DONE, ERROR = 1, 2, 4
SIZE = 40


class Belt:
    """What the server asks for data, and the program that is called in each cycle."""

    def __init__(self) -> None:
        self.words = [0] * SIZE
        self.ends_at: float | None = None
        self.working_on = 0

    @property
    def job(self) -> int:
        return int.from_bytes(b"".join(word.to_bytes(2, "big") for word in self.words[JOB : JOB + 2]), signed=True)

    def device_ids(self) -> list[int]:
        return [1]

    async def async_getValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, count: int = 1
    ) -> list[int] | ExcCodes:
        return ExcCodes.ILLEGAL_ADDRESS if address + count > SIZE else self.words[address : address + count]

    async def async_setValues(  # noqa: N802 - the name is pymodbus's
        self, device_id: int, func_code: int, address: int, values: list[int]
    ) -> ExcCodes | None:
        if address + len(values) > SIZE:
            return ExcCodes.ILLEGAL_ADDRESS
        self.words[address : address + len(values)] = values
        return None

    def cycle(self, now: float) -> None:
        words = self.words
        if self.ends_at is not None:
            if now >= self.ends_at:
                say(f"done {self.working_on}")
                self.ends_at, words[STATE] = None, DONE
        elif words[REQUEST] not in (0, words[ACCEPTED]):
            self.working_on = self.job
            if self.working_on < 0:
                say(f"refused {self.working_on}")
                text = b"the belt is too short".ljust(40, b"\0")
                words[TEXT : TEXT + 20] = [int.from_bytes(text[at : at + 2], "big") for at in range(0, 40, 2)]
                words[STATE] = ERROR
            else:
                say(f"begun {self.working_on}")
                words[STATE], self.ends_at = BUSY, now + self.working_on % 100 / 10
            words[ACCEPTED] = words[REQUEST]


async def main() -> None:
    belt = Belt()
    nothing = SimDevice(0, [SimData(0, values=0, datatype=DataType.REGISTERS)])
    server = ModbusTcpServer(nothing, address=("127.0.0.1", int(sys.argv[1])))
    server.context = belt  # type: ignore[assignment]  # it uses the three methods alone
    await server.serve_forever(background=True)
    say("ready")
    while True:
        belt.cycle(asyncio.get_running_loop().time())
        await asyncio.sleep(0.01)


asyncio.run(main())
