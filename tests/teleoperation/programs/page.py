"""The same device as `tab.py`, as the console's own page in a real Chromium: `page.py SOCKET SETTINGS_JSON`.

Somebody logs in, presses `Drive` and holds a key. What the page sends is noted in the page itself, before it goes: its
clock is brought to that of the processes, to within a few milliseconds. KIND is always `new`; a speed is a tenth of the
greatest, or some.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any, Final

from playwright.async_api import Error, Page, async_playwright

from tests.console.browsing import chromium_options
from tests.teleoperation.programs.control import serve

ENABLED_S: Final = 3.0
GRANT_S: Final = 8.0
SHOWN_S: Final = 1.0
KEY: Final = "w"
_NOTE: Final = """
(() => {
  const now = () => performance.now() / 1000
  const drive = window.noted = { lease: 0, over: 'nothing was held', seen: {}, wishes: [], socket: null }
  const Plain = WebSocket
  window.WebSocket = class extends Plain {
    constructor(url, ...rest) {
      super(url, ...rest)
      if (!String(url).endsWith('/api/drive')) return
      Object.assign(drive, { lease: 0, over: '', seen: {}, socket: this })
      this.addEventListener('message', ({ data }) => {
        if (drive.socket !== this) return
        const said = JSON.parse(data)
        if (said.held) drive.lease = said.held.lease
        if (said.over) drive.over ||= said.over.message
        const counter = said.held?.counter ?? said.counter
        if (counter !== undefined) drive.seen[counter] ??= now()
      })
      this.addEventListener('close', event => {
        if (drive.socket === this) drive.over ||= `closed: ${event.code} ${event.reason}`
      })
    }
    send(text) {
      if (drive.socket === this) {
        const { n, echo, values } = JSON.parse(text)
        if (n) drive.wishes.push([now(), drive.seen[echo], drive.lease, values[0], echo])
      }
      super.send(text)
    }
  }
})()
"""


class Tab:
    """See the module."""

    def __init__(self, page: Page, settings: dict[str, Any]) -> None:
        self._page, self._settings = page, settings
        self._offset_s = 0.0

    async def log_in(self) -> None:
        """Log in as people do, and go to where the robot is driven."""
        page, settings = self._page, self._settings
        await page.add_init_script(_NOTE)
        await page.goto(f"{settings['console']}/#/{settings['fleet']}/drive/{settings['robot']}")
        await page.get_by_label("Fleet").select_option(settings["fleet"])
        await page.get_by_label("User").fill(settings["user"])
        await page.get_by_label("Password").fill(settings["password"])
        await page.get_by_role("button", name="Log in").click()
        await page.get_by_role("heading", level=1, name=f"Drive {settings['robot']}").wait_for()
        offsets: list[tuple[float, float]] = []
        for _ in range(20):
            before = time.monotonic()
            at = await page.evaluate("performance.now() / 1000")
            after = time.monotonic()
            offsets.append((after - before, (before + after) / 2 - at))
        self._offset_s = min(offsets)[1]

    async def answer(self, said: dict[str, Any]) -> dict[str, Any]:
        match said["do"]:
            case "acquire":
                return await self._acquire()
            case "wish":
                await self._wish(said["speed"])
            case "release":
                await self._page.keyboard.press("Escape")
            case "state":
                await self._tell()
                return {"over": await self._page.evaluate("noted.over")}
            case other:
                raise ValueError(other)
        return {"at": time.monotonic()}

    async def _acquire(self) -> dict[str, Any]:
        page = self._page
        await page.keyboard.up(KEY)
        await self._tell()
        asked = time.monotonic()
        try:
            button = page.get_by_role("button", name="Drive", exact=True)
            while await button.get_attribute("aria-disabled", timeout=ENABLED_S * 1000) == "true":
                if time.monotonic() > asked + ENABLED_S:
                    return {"refused": "the page does not offer to drive"}
                await asyncio.sleep(0.02)
            before = await page.evaluate("noted.lease")
            asked = time.monotonic()
            await button.click(timeout=ENABLED_S * 1000)
            while (lease := await page.evaluate("noted.lease")) in (0, before):
                over = await page.evaluate("noted.over")
                if over or time.monotonic() > asked + GRANT_S:
                    return {"refused": over or "no answer"}
                await asyncio.sleep(0.02)
        except Error as error:
            return {"refused": str(error)}
        granted = time.monotonic()
        print("lease", lease, asked, granted, flush=True)
        return {"lease": lease, "asked": asked, "granted": granted}

    async def _wish(self, speed: float | None) -> None:
        keyboard = self._page.keyboard
        if not speed:
            await keyboard.up(KEY)
            return
        slider = self._page.get_by_role("slider")
        tenths = round(10 * speed / self._settings["speed"])
        for _ in range(10):
            try:
                found = round(int(await slider.input_value(timeout=SHOWN_S * 1000)) / 10)
            except Error:
                return  # the lease is over, and the desk gone with it
            if found == tenths:
                break
            await keyboard.press("+" if found < tenths else "-")
        await keyboard.down(KEY)

    async def _tell(self) -> None:
        for sent, seen, lease, speed, echo in await self._page.evaluate("noted.wishes.splice(0)"):
            print("wish", sent + self._offset_s, seen + self._offset_s, lease, speed, echo, flush=True)


async def main() -> None:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**chromium_options())
        page = await browser.new_page()
        tab = Tab(page, json.loads(sys.argv[2]))
        await tab.log_in()
        await serve(sys.argv[1], tab.answer)


asyncio.run(main())
